"""``starbench frame``: zoomable HTML page of a FITS image, with detected, true and catalogue stars."""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from experiments.harness.interrupts import invoke
from optics.errors import ConfigError

if TYPE_CHECKING:
    from astropy.io import fits

    from calib.records import SensorImage
    from optics.frame_html import Marks

CARDS = ("OBJECT", "DATE-OBS", "EXPTIME", "FILTER", "INSTRUME", "TELESCOP", "GAIN", "CCD-TEMP")
NEAR_PX = 3.0
HELP = """Zoomable HTML page of a FITS image: pixel values, stars, truth, catalogue; needs no server or network."""


@click.group("frame", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
def frame() -> None:
    """The command with its subcommands."""


@frame.command(help="Write the page of the image FILE.")
@click.argument("file", type=click.Path(readable=False, path_type=Path))
@click.option(
    "--out",
    metavar="HTML",
    type=click.Path(readable=False, path_type=Path),
    help="path of the page; default: the file's name with .html",
)
@click.option("--hdu", metavar="N", help="extension, by number or name; default: the first image")
@click.option("--plane", type=int, metavar="N", help="plane of an image cube")
@click.option("--stars/--no-stars", "find", default=True, help="detect and measure stars")
@click.option("--sigma", default=5.0, show_default=True, help="detection threshold, standard deviations")
@click.option(
    "--truth",
    metavar="TABLE",
    type=click.Path(readable=False, path_type=Path),
    help="true positions, columns x_px, y_px (ECSV, CSV, Parquet); a dataset's frame has them",
)
@click.option(
    "--catalogue",
    type=float,
    metavar="MAG",
    help="mark Gaia's stars to this G magnitude, if the file has sky coordinates",
)
def show(file: Path, out: Path | None, hdu: str | None, catalogue: float | None, **options: Any) -> None:
    """Write the page and say what it marks."""
    page = out or Path(file.name.partition(".")[0] + ".html")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    extension = int(hdu) if hdu is not None and hdu.isdecimal() else hdu
    for marks in _write_page(file, page, hdu=extension, faintest_mag=catalogue, **options):
        click.echo(f"{len(marks.x_px)} {marks.name}")
    click.echo(f"page: {page}")


def _write_page(
    file: Path,
    page: Path,
    *,
    hdu: int | str | None,
    plane: int | None,
    find: bool,
    sigma: float,
    truth: Path | None,
    faintest_mag: float | None,
) -> list[Marks]:
    """Write the page; return the marks on it."""
    from calib.figures import star_marks
    from calib.measure.find import find_stars
    from calib.measure.images.sensor_image import read_image
    from experiments.laboratory.bench.truth_marks import truth_marks
    from optics.fits import image_header
    from optics.frame_html import differences, save_frame_page
    from render.fits.wcs import sky_grid

    image = read_image(file, hdu=hdu, plane=plane)
    header = image_header(file, hdu)
    sky = sky_grid(header, image.dn.shape)
    stars, reference = [], []
    if table := truth or _truth_beside(file):
        reference.append(truth_marks(_columns(table)))
    if faintest_mag is not None:
        if sky is None:
            raise ConfigError(f"{file}: has no world coordinates, so no star of the catalogue can be placed")
        reference.append(_catalogue(header, image.dn.shape, faintest_mag))
    if find:
        stars = star_marks(find_stars(image, "gaussian", threshold_sigma=sigma))
    placed = [layer for layer in stars if layer.shape != "cross"]
    arrows = [differences(placed, layer, within_px=NEAR_PX) for layer in reference if placed]
    save_frame_page(
        page,
        _values(image),
        [*reference, *stars, *arrows],
        title=file.name,
        facts=_facts(header),
        flags={"saturated": image.saturated},
        sky=sky,
        noise=image.noise.read_noise_e * image.noise.gain_dn_per_e or None,
    )
    return [*reference, *stars]


def _values(image: SensorImage) -> Any:
    import numpy as np

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
    import numpy as np
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
    import numpy as np
    from astropy.wcs import WCS

    from optics.frame_html import Marks
    from optics.frames import equatorial_deg
    from render.sky.sky import load_sky

    known = load_sky(faintest_mag=faintest_mag)
    ra, dec = equatorial_deg(known.direction)
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


if __name__ == "__main__":
    sys.exit(invoke(frame, None, prog="starbench frame", own_process=True))
