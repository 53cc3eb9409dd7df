"""``starbench lens``: page of a lens file, its ghosts, its image over temperature, conversion to another format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np

from optics.errors import ConfigError
from optics.textfile import write_text

HELP = """Lens files of Zemax (.zmx), CODE V (.seq) and our own (.toml); zoom.zmx#2 is the second configuration."""


def _reading(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options of every reading."""
    for option in reversed(
        (
            click.option("--strict", is_flag=True, help="refuse every approximation of the file"),
            click.option("--glass", multiple=True, metavar="OLD=NEW", help="substitute glass NEW for OLD"),
            click.option(
                "--catalogue", multiple=True, metavar="AGF", help="glass catalogue, in addition to the built-in one"
            ),
        )
    ):
        function = option(function)
    return function


def _replacements(given: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for one in given:
        old, equals, new = one.partition("=")
        if not (old.strip() and equals and new.strip()):
            raise ConfigError(f"--glass {one}: OLD=NEW is needed, e.g. --glass BK7=N-BK7")
        pairs[old.strip()] = new.strip()
    return pairs


def _read(path: str, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> Any:
    from optics.lens_file import read_lens_file

    return read_lens_file(path, catalogues=catalogue, glasses=_replacements(glass), strict=strict)


def _tell(file: Any) -> None:
    """Counts, inexact lines and first-order data on the terminal."""
    report = file.report
    if report is None:
        return
    click.echo(str(report))
    for line in report.inexact:
        click.echo(f"  {line}")
    for one in report.comparisons:
        computed, stated = ("–" if v is None else f"{v:.6g}" for v in (one.computed, one.stated))
        click.echo(f"  {one.name}: {computed} {one.unit}" + (f" (file: {stated}, {one.source})" if one.source else ""))


@click.group("lens", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
def lens() -> None:
    """The command with its subcommands."""


@lens.command(help="One HTML page: prescription, first-order data, drawing, spots, distortion, colour, MTF, report.")
@click.argument("file", type=click.Path(readable=False))
@click.option("--out", default=None, metavar="HTML", help="path of the page; default: the file's name with .html")
@_reading
def show(file: str, out: str | None, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> None:
    read = _read(file, strict, glass, catalogue)
    page = Path(out) if out else Path(Path(file.partition("#")[0]).stem + ".html")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    _tell(read)
    from experiments.lens.page import page_of

    write_text(page, page_of(read, Path(file).name))
    click.echo(f"page: {page}")


@lens.command(help="Convert a lens file to .toml, .zmx or .seq.")
@click.argument("file", type=click.Path(readable=False))
@click.argument("new")
@click.option("--force", is_flag=True, help="overwrite an existing file")
@_reading
def convert(file: str, new: str, force: bool, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...]) -> None:
    from optics.export.write import write_lens

    if Path(new).exists() and not force:
        raise ConfigError(f"{new} exists; --force overwrites it")
    read = _read(file, strict, glass, catalogue)
    _tell(read)
    for path in write_lens(read, new):
        click.echo(f"written: {path}")
    if not new.lower().endswith(".toml") and any(surface.coating is not None for surface in read.lens.surfaces):
        click.echo("coatings are left out: only .toml holds them")


@lens.command(help="List the ghosts of a star, brightest first: all pairs of surfaces, detector and window included.")
@click.argument("file", type=click.Path(readable=False))
@click.option(
    "--field",
    multiple=True,
    type=float,
    metavar="DEG",
    help="field angle along x, repeatable; default: 0 and 0.7 of the field",
)
@click.option("--wavelength", default=None, type=float, metavar="NM", help="wavelength; default: the design wavelength")
@click.option(
    "--coating-nm",
    default=550.0,
    show_default=True,
    help="quarter-wave MgF2 coating of surfaces without a coating in the file; 0: bare",
)
@click.option("--detector", default=0.2, show_default=True, help="reflectance of the detector")
@click.option(
    "--window", default=None, metavar="GLASS:MM:GAP", help="detector window: glass, thickness, gap to the detector"
)
@click.option("--pixel-um", default=5.5, show_default=True, help="pixel size for the brightest pixel of a ghost")
@click.option("--absorption/--no-absorption", default=True, show_default=True, help="absorption in glass")
@click.option("--roughness-nm", default=1.0, show_default=True, help="RMS roughness of all surfaces (scatter)")
@click.option("--cleanliness", default=300.0, show_default=True, help="IEST-STD-CC1246 level of the first surface")
@click.option("--rows", default=10, show_default=True, help="ghosts listed for every field angle")
@_reading
def ghosts(
    file: str,
    field: tuple[float, ...],
    wavelength: float | None,
    coating_nm: float,
    detector: float,
    window: str | None,
    pixel_um: float,
    absorption: bool,
    roughness_nm: float,
    cleanliness: float,
    rows: int,
    strict: bool,
    glass: tuple[str, ...],
    catalogue: tuple[str, ...],
) -> None:
    from optics.frames import field_direction
    from optics.glass.coating import QuarterWave
    from optics.light.bsdf import area_coverage, lens_scatter
    from optics.rays.ghosts import find_ghosts, ghost_pairs, with_cover_glass

    if not pixel_um > 0.0:
        raise ConfigError(f"--pixel-um {pixel_um:g}: it must be positive")
    made = _read(file, strict, glass, catalogue).lens
    if window is not None:
        made = with_cover_glass(made, *_window(window))
    end = len(made.surfaces)
    rough = lens_scatter(made, roughness_nm, made.design_wavelength_nm if wavelength is None else wavelength)
    dust = area_coverage(cleanliness)
    click.echo(f"{made.name}: {len(ghost_pairs(made))} pairs of surfaces; {end} is the detector")
    click.echo(f"scattered by roughness of {roughness_nm:g} nm: {100.0 * rough:.4g} %")
    click.echo(f"covered by dust of level {cleanliness:g}: {100.0 * dust:.4g} % of a surface")
    for angle in field or (0.0, 0.7 * made.max_field_deg):
        found = find_ghosts(
            made,
            field_direction(angle, 0.0),
            wavelength_nm=wavelength,
            coating=QuarterWave(design_wavelength_nm=coating_nm) if coating_nm > 0.0 else None,
            detector_reflectance=detector,
            absorption=absorption,
        )
        click.echo(f"\nstar at {angle:g} deg, image at ({found.image_x_mm:.3f}, {found.image_y_mm:.3f}) mm")
        click.echo("  back forward  magnitude     x [mm]     y [mm]  RMS radius [mm]  mag of its brightest pixel")
        peak = -2.5 * np.log10(found.brightest_pixel(1e-3 * pixel_um))
        for k in range(min(rows, len(found.flux))):
            click.echo(
                f"  {found.back[k]:4d} {found.forward[k]:7d} {found.magnitude[k]:+10.2f} {found.x_mm[k]:10.3f} "
                f"{found.y_mm[k]:10.3f} {found.rms_mm[k]:16.4f} {peak[k]:+10.2f}{'  sharp' if found.sharp[k] else ''}"
            )
        if len(peak):
            k = int(np.argmin(peak))
            click.echo(f"  brightest pixel: pair {found.back[k]}, {found.forward[k]}, {peak[k]:+.2f} mag")
        books = found.ledger
        parts = ", ".join(
            f"{one} {max(0.0, round(100.0 * getattr(books, one), 9)):.4g} %" for one in books.__dataclass_fields__
        )
        click.echo(f"  of the light on the first surface: {parts}")


@lens.command(
    help="Change of focus, scale and boresight per kelvin of lens and housing, and the spacer that holds the focus."
)
@click.argument("file", type=click.Path(readable=False))
@click.option("--housing", default=None, metavar="MATERIAL", help="material of the barrel, or its expansion in 1e-6/K")
@click.option("--diameter", type=float, metavar="MM", help="diameter of the barrel; default: the widest clear aperture")
@click.option(
    "--mounted",
    type=float,
    metavar="MM",
    help="z of the mounting plane, fixed when the barrel bends; default: image plane",
)
@click.option(
    "--spacer",
    multiple=True,
    metavar="NAME=MATERIAL",
    help="material of the spacer in front of an element, the stop or the detector",
)
@click.option("--rim", multiple=True, metavar="NAME=FRONT:BACK", help="contact radii [mm] of the spacers on an element")
@click.option("--field", type=float, metavar="DEG", help="half diagonal of the traced square field")
@click.option("--athermal", multiple=True, metavar="NAME", help="spacer to solve for; default: all")
@click.option(
    "--second",
    default="invar_36",
    show_default=True,
    metavar="MATERIAL",
    help="second material, in series with that spacer",
)
@_reading
def thermal(
    file: str,
    housing: str | None,
    diameter: float | None,
    mounted: float | None,
    spacer: tuple[str, ...],
    rim: tuple[str, ...],
    field: float | None,
    athermal: tuple[str, ...],
    second: str,
    strict: bool,
    glass: tuple[str, ...],
    catalogue: tuple[str, ...],
) -> None:
    from experiments.lens.thermal import thermal_lines
    from optics.validate import parse_model
    from render.sensor_file.housing import HousingConfig
    from render.sensor_file.instrument import housing_of

    given: dict[str, Any] = {"diameter_mm": diameter, "mounted_z_mm": mounted}
    given |= {"material": None if housing is None else _material(housing)}
    given = {key: value for key, value in given.items() if value is not None}
    given["spacers"] = {name: _material(text) for name, text in _pairs("spacer", spacer, "L6=invar_36")}
    given["rims_mm"] = {name: _radii(text) for name, text in _pairs("rim", rim, "L1=35:35")}
    table = parse_model(HousingConfig, given, "housing")
    made = _read(file, strict, glass, catalogue).lens
    for line in thermal_lines(made, housing_of(table), _material(second), corner_deg=field, spacers=athermal):
        click.echo(line)


def _pairs(option: str, given: tuple[str, ...], example: str) -> list[tuple[str, str]]:
    """Name and value of NAME=VALUE."""
    pairs = [tuple(part.strip() for part in one.partition("=")[::2]) for one in given]
    for one, (name, value) in zip(given, pairs, strict=True):
        if not (name and value):
            raise ConfigError(f"--{option} {one}: NAME=VALUE is needed, e.g. --{option} {example}")
    return [(name, value) for name, value in pairs]


def _material(text: str) -> str | float:
    """A material's name, or its expansion."""
    try:
        return float(text)
    except ValueError:
        return text


def _radii(text: str) -> tuple[float, float]:
    front, _, back = text.partition(":")
    try:
        return float(front), float(back)
    except ValueError:
        raise ConfigError(f"--rim {text}: FRONT:BACK in mm is needed, e.g. --rim L1=35:35") from None


def _window(text: str) -> tuple[str, float, float]:
    """Glass, thickness and gap [mm] of ``GLASS:MM:GAP``."""
    name, _, rest = text.partition(":")
    thickness, _, gap = rest.partition(":")
    try:
        return name, float(thickness), float(gap)
    except ValueError:
        raise ConfigError(f"--window {text}: GLASS:MM:GAP is needed, e.g. --window N-BK7:0.5:1.0") from None
