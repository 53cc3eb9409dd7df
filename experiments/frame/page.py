"""From a FITS image to its page: pixels, stars that are found, truth and catalogue where there are any."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits

from calib.figures import star_marks
from calib.measure.find import find_stars
from calib.measure.image import read_image
from calib.records import SensorImage
from experiments.laboratory.truth_marks import truth_marks
from optics.errors import ConfigError
from optics.fits import image_header
from optics.page import Marks, differences, save_frame_page
from render.fits.wcs import sky_grid

__all__ = ["Asked", "write_page"]

CARDS = ("OBJECT", "DATE-OBS", "EXPTIME", "FILTER", "INSTRUME", "TELESCOP", "GAIN", "CCD-TEMP")
NEAR_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What the page is made of."""

    file: Path  # FITS image
    hdu: int | str | None = None  # As `calib.measure.image.read_image`
    plane: int | None = None  # As `calib.measure.image.read_image`
    sigma: float | None = 5.0  # Threshold of detection; None finds no stars
    truth: Path | None = None  # Table of places; None takes the truth of a dataset that the file is of
    faintest_mag: float | None = None  # Stars of the catalogue to this magnitude; None marks none


def write_page(asked: Asked, page: Path) -> Iterator[str]:
    """Write the page; what was found is told line by line."""
    image = read_image(asked.file, hdu=asked.hdu, plane=asked.plane)
    header = image_header(asked.file, asked.hdu)
    sky = sky_grid(header, image.dn.shape)
    layers, reference = [], []
    if truth := asked.truth or _truth_beside(asked.file):
        reference.append(truth_marks(_columns(truth)))
    if asked.faintest_mag is not None:
        if sky is None:
            raise ConfigError(f"{asked.file}: has no world coordinates, so no star of the catalogue can be placed")
        reference.append(_catalogue(header, image.dn.shape, asked.faintest_mag))
    if asked.sigma is not None:
        layers = star_marks(find_stars(image, "gaussian", threshold_sigma=asked.sigma))
    counted = [layer for layer in layers if layer.shape != "cross"]
    arrows = [differences(counted, one, within_px=NEAR_PX) for one in reference if counted]
    save_frame_page(
        page,
        _values(image),
        [*reference, *layers, *arrows],
        title=asked.file.name,
        facts=_facts(header),
        flags={"saturated": image.saturated},
        sky=sky,
        noise=image.noise.read_noise_e * image.noise.gain_dn_per_e or None,
    )
    for layer in (*reference, *layers):
        yield f"{len(layer.x_px)} {layer.name}"


def _values(image: SensorImage) -> Any:
    whole = image.dn.astype(np.int64)
    if np.array_equal(whole, image.dn) and image.valid.all():
        return whole
    return np.where(image.valid, image.dn, np.nan)


def _facts(header: fits.Header) -> dict[str, str]:
    """What cards say, with the unit that FITS puts in brackets at the begin of a comment (seconds are EXPTIME's)."""
    facts = {}
    for name in CARDS:
        value = header.get(name)
        if value in (None, ""):
            continue
        unit = re.match(r"\[([^\]]+)\]", header.comments[name])
        text = f"{value:.6g}" if isinstance(value, float) else str(value).strip()
        facts[name] = f"{text} {unit[1] if unit else 's' if name == 'EXPTIME' else ''}".strip()
    return facts


def _truth_beside(file: Path) -> Path | None:
    """Truth of a frame of a dataset: ``truth/frame_000001.parquet`` of ``frames/frame_000001.fits``."""
    if file.resolve().parent.name != "frames":
        return None
    folder = file.resolve().parents[1] / "truth"
    return next((path for form in ("parquet", "ecsv") if (path := folder / f"{file.stem}.{form}").is_file()), None)


def _columns(path: Path) -> dict[str, Any]:
    """Columns of a table in any of the usual forms."""
    from astropy.table import Table

    try:
        if path.suffix == ".parquet":
            import pyarrow.parquet as pq

            columns = pq.read_table(path)
            return {name: columns.column(name).to_numpy() for name in columns.column_names}
        table = Table.read(path, format={".ecsv": "ascii.ecsv", ".csv": "ascii.csv"}.get(path.suffix))
        return {name: np.asarray(table[name]) for name in table.colnames}
    except Exception as error:  # pyarrow and astropy raise what their readers happen to raise
        raise ConfigError(f"{path}: no table that can be read ({' '.join(str(error).split())[:160]})") from None


def _catalogue(header: fits.Header, shape: tuple[int, int], faintest_mag: float) -> Marks:
    """Stars of the built-in sky in the frame, brightest first."""
    import warnings

    from astropy.wcs import WCS

    from render.sky.sky import load_sky

    known = load_sky(faintest_mag=faintest_mag)
    ra = np.degrees(np.arctan2(known.direction[:, 1], known.direction[:, 0])) % 360.0
    dec = np.degrees(np.arcsin(np.clip(known.direction[:, 2], -1.0, 1.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        world = WCS(header, naxis=2).celestial
        rows, columns = shape
        centre = world.pixel_to_world(0.5 * columns, 0.5 * rows).icrs.cartesian.xyz.value
        corner = world.pixel_to_world(-0.5, -0.5).icrs.cartesian.xyz.value
        near = np.flatnonzero(known.direction @ centre > min(float(centre @ corner), 1.0) - 1e-4)
        x, y = world.all_world2pix(ra[near], dec[near], 0, quiet=True)
    inside = (np.abs(x - 0.5 * (columns - 1)) <= 0.5 * columns) & (np.abs(y - 0.5 * (rows - 1)) <= 0.5 * rows)
    magnitude = known.magnitude[near]
    order = np.flatnonzero(inside)[np.argsort(magnitude[inside], kind="stable")]
    stars = near[order]
    return Marks(
        name="catalogue",
        x_px=x[order],
        y_px=y[order],
        colour="#ffd166",
        label=[f"{one:.1f}" for one in magnitude[order]],
        columns={
            "star": np.asarray(known.id)[stars],
            "magnitude": magnitude[order],
            "right ascension [deg]": ra[stars],
            "declination [deg]": dec[stars],
        },
    )
