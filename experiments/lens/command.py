"""``starbench lens``: page of a lens file, its ghosts, its image over temperature, conversion to another format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import wraps
from pathlib import Path
from typing import Any

import click
import numpy as np

from optics.errors import ConfigError
from optics.textfile import write_text

Read = Callable[[], Any]

HELP = """Lens files of Zemax (.zmx), CODE V (.seq) and our own (.toml); zoom.zmx#2 is the second configuration."""


def _lens_file_argument(function: Callable[..., Any]) -> Callable[..., Any]:
    """Argument FILE and its options; the command gets the name as ``file`` and a function ``read`` in their place."""

    @click.argument("file", type=click.Path(readable=False))
    @click.option("--strict", is_flag=True, help="refuse every approximation of the file")
    @click.option("--glass", multiple=True, metavar="OLD=NEW", help="substitute glass NEW for OLD")
    @click.option("--catalogue", multiple=True, metavar="AGF", help="glass catalogue, in addition to the built-in one")
    @wraps(function)
    def command(file: str, strict: bool, glass: tuple[str, ...], catalogue: tuple[str, ...], **options: Any) -> Any:
        def read() -> Any:
            from optics.lens_file import read_lens_file

            glasses = dict(_pairs("glass", glass, "BK7=N-BK7", "OLD=NEW"))
            return read_lens_file(file, catalogues=catalogue, glasses=glasses, strict=strict)

        return function(file=file, read=read, **options)

    return command


def _echo_report(file: Any) -> None:
    """Counts, inexact lines and first-order data on the terminal."""
    report = file.report
    if report is None:
        return
    click.echo(str(report))
    for line in report.inexact:
        click.echo(f"  {line}")
    for row in report.comparisons:
        computed, stated = ("–" if v is None else f"{v:.6g}" for v in (row.computed, row.stated))
        click.echo(f"  {row.name}: {computed} {row.unit}" + (f" (file: {stated}, {row.source})" if row.source else ""))


@click.group("lens", help=HELP, context_settings={"help_option_names": ["-h", "--help"]})
def lens() -> None:
    """The command with its subcommands."""


@lens.command(help="One HTML page: prescription, first-order data, drawing, spots, distortion, colour, MTF, report.")
@_lens_file_argument
@click.option("--out", default=None, metavar="HTML", help="path of the page; default: the file's name with .html")
def show(file: str, read: Read, out: str | None) -> None:
    lens_file = read()
    page = Path(out) if out else Path(Path(file.partition("#")[0]).stem + ".html")
    if not page.parent.is_dir():
        raise ConfigError(f"{page}: the folder {page.parent} does not exist")
    _echo_report(lens_file)
    from experiments.lens.page import page_of

    write_text(page, page_of(lens_file, Path(file).name))
    click.echo(f"page: {page}")


@lens.command(help="Convert a lens file to .toml, .zmx or .seq.")
@_lens_file_argument
@click.argument("new")
@click.option("--force", is_flag=True, help="overwrite an existing file")
def convert(file: str, read: Read, new: str, force: bool) -> None:
    from optics.export.write import write_lens

    if Path(new).exists() and not force:
        raise ConfigError(f"{new} exists; --force overwrites it")
    lens_file = read()
    _echo_report(lens_file)
    for path in write_lens(lens_file, new):
        click.echo(f"written: {path}")
    if not new.lower().endswith(".toml") and any(surface.coating is not None for surface in lens_file.lens.surfaces):
        click.echo("coatings are left out: only .toml holds them")


@lens.command(help="List the ghosts of a star, brightest first: all pairs of surfaces, detector and window included.")
@_lens_file_argument
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
def ghosts(
    file: str,
    read: Read,
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
) -> None:
    from optics.frames import field_direction
    from optics.glass.coating import QuarterWave
    from optics.light.bsdf import area_coverage, lens_scatter
    from optics.rays.ghosts import find_ghosts, ghost_pairs, with_cover_glass

    if not pixel_um > 0.0:
        raise ConfigError(f"--pixel-um {pixel_um:g}: it must be positive")
    system = read().lens
    if window is not None:
        system = with_cover_glass(system, *_window(window))
    rough = lens_scatter(system, roughness_nm, system.design_wavelength_nm if wavelength is None else wavelength)
    click.echo(f"{system.name}: {len(ghost_pairs(system))} pairs of surfaces; {len(system.surfaces)} is the detector")
    click.echo(f"scattered by roughness of {roughness_nm:g} nm: {100.0 * rough:.4g} %")
    click.echo(f"covered by dust of level {cleanliness:g}: {100.0 * area_coverage(cleanliness):.4g} % of a surface")
    for angle in field or (0.0, 0.7 * system.max_field_deg):
        table = find_ghosts(
            system,
            field_direction(angle, 0.0),
            wavelength_nm=wavelength,
            coating=QuarterWave(design_wavelength_nm=coating_nm) if coating_nm > 0.0 else None,
            detector_reflectance=detector,
            absorption=absorption,
        )
        click.echo(f"\nstar at {angle:g} deg, image at ({table.image_x_mm:.3f}, {table.image_y_mm:.3f}) mm")
        click.echo("  back forward  magnitude     x [mm]     y [mm]  RMS radius [mm]  mag of its brightest pixel")
        peak = -2.5 * np.log10(table.brightest_pixel(1e-3 * pixel_um))
        for k in range(min(rows, len(table.flux))):
            click.echo(
                f"  {table.back[k]:4d} {table.forward[k]:7d} {table.magnitude[k]:+10.2f} {table.x_mm[k]:10.3f} "
                f"{table.y_mm[k]:10.3f} {table.rms_mm[k]:16.4f} {peak[k]:+10.2f}{'  sharp' if table.sharp[k] else ''}"
            )
        if len(peak):
            k = int(np.argmin(peak))
            click.echo(f"  brightest pixel: pair {table.back[k]}, {table.forward[k]}, {peak[k]:+.2f} mag")
        fractions = asdict(table.ledger).items()
        parts = ", ".join(f"{name} {max(0.0, round(100.0 * value, 9)):.4g} %" for name, value in fractions)
        click.echo(f"  of the light on the first surface: {parts}")


@lens.command(
    help="Change of focus, scale and boresight per kelvin of lens and housing, and the spacer that holds the focus."
)
@_lens_file_argument
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
def thermal(
    file: str,
    read: Read,
    housing: str | None,
    diameter: float | None,
    mounted: float | None,
    spacer: tuple[str, ...],
    rim: tuple[str, ...],
    field: float | None,
    athermal: tuple[str, ...],
    second: str,
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
    for line in thermal_lines(read().lens, housing_of(table), _material(second), corner_deg=field, spacers=athermal):
        click.echo(line)


def _pairs(option: str, given: tuple[str, ...], example: str, form: str = "NAME=VALUE") -> list[tuple[str, str]]:
    """Name and value of every NAME=VALUE."""
    pairs = []
    for text in given:
        name, _, value = (part.strip() for part in text.partition("="))
        if not (name and value):
            raise ConfigError(f"--{option} {text}: {form} is needed, e.g. --{option} {example}")
        pairs.append((name, value))
    return pairs


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
