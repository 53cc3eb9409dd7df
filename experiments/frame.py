"""``starbench frame``: zoomable HTML page of a FITS image, with detected, true and catalogue stars."""

from __future__ import annotations

import re
import sys
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
        marks = _catalogue(header, image.dn.shape, faintest_mag)
        if marks is None:
            raise ConfigError(f"{file}: has no world coordinates, so no star of the catalogue can be placed")
        reference.append(marks)
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
            import pyarrow as pa
            import pyarrow.parquet as pq

            columns = pq.read_table(path)
            # A gap would make identifiers floats, which hold 16 digits
            whole = {field.name for field in columns.schema if pa.types.is_integer(field.type)}
            return {
                name: (column.fill_null(-1) if name in whole else column).to_numpy()
                for name, column in zip(columns.column_names, columns.columns, strict=True)
            }
        table = Table.read(path, format={".ecsv": "ascii.ecsv", ".csv": "ascii.csv"}.get(path.suffix))
        return {name: np.asarray(table[name]) for name in table.colnames}
    except Exception as error:  # pyarrow and astropy raise what their readers happen to raise
        raise ConfigError(f"{path}: no table that can be read ({' '.join(str(error).split())[:160]})") from None


def _catalogue(header: fits.Header, shape: tuple[int, int], faintest_mag: float) -> Marks | None:
    """Stars of the built-in sky in the frame, brightest first; None without world coordinates."""
    import numpy as np

    from optics.frame_html import Marks
    from optics.frames import equatorial_deg
    from render.fits.wcs import catalogue_pixels
    from render.sky.sky import load_sky

    sky = load_sky(faintest_mag=faintest_mag)
    if (pixels := catalogue_pixels(header, shape, sky.direction)) is None:
        return None
    rows, position = pixels
    order = np.argsort(sky.magnitude[rows], kind="stable")
    stars, position = rows[order], position[order]
    ra, dec = equatorial_deg(sky.direction[stars])
    return Marks(
        name="catalogue",
        x_px=position[:, 0],
        y_px=position[:, 1],
        colour="#ffd166",
        label=[f"{magnitude:.1f}" for magnitude in sky.magnitude[stars]],
        columns={
            "star": np.asarray(sky.id)[stars],
            "magnitude": sky.magnitude[stars],
            "right ascension [deg]": ra,
            "declination [deg]": dec,
        },
    )


if __name__ == "__main__":
    sys.exit(invoke(frame, None, prog="starbench frame", own_process=True))
