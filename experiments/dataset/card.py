"""Data card: the README.md of a dataset, for whoever finds the folder."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.dataset.folder import IDENTITY
from experiments.dataset.identity import identity
from experiments.dataset.plan import SPLITS
from experiments.dataset.truth import COLUMNS, FLAGS
from experiments.dataset.truth_file import INDEX_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.dataset.result import Result
    from experiments.dataset.truth import Column

__all__ = ["data_card"]


def data_card(result: Result) -> str:
    """Markdown; the same dataset gives the same text, whoever made how much of it and when."""
    parts = [_head(result), _reading(result), _folder(result), _conventions(), _columns(), _origin(result)]
    return "\n\n".join(parts) + "\n"


def _head(result: Result) -> str:
    camera, chip = result.scene.instrument.camera, result.scene.instrument.detector
    settings = result.config.camera
    width, height = (2.0 * math.degrees(math.atan(half)) for half in _half_fields(result))
    counts = Counter(one.split for one in result.facts)
    stars = sum(one.stars for one in result.facts)
    empty = sum(one.stars == 0 for one in result.facts)
    band = result.scene.light.band[0]
    lines = [
        f"# {len(result.facts)} frames of the real sky with exact truth",
        "",
        "Synthetic frames of a star sensor: real stars, traced one by one through every surface of a lens, read out by "
        "a modelled detector. Beside every frame stands a table that says where each star truly is, how much light it "
        "gave, and what went wrong with it.",
        "",
        "| | |",
        "|---|---|",
        f"| frames | {len(result.facts)} ({', '.join(f'{counts[split]} {split}' for split in SPLITS)}) |",
        f"| star images | {stars}, {stars / len(result.facts):.1f} per frame; {empty} frames without any |",
        f"| frame | {camera.width_px} x {camera.height_px} px, 16 bit, {width:.2f} x {height:.2f} deg, "
        f"{result.scene.instrument.pixel_arcsec:.2f} arcsec per pixel on the axis |",
        f"| lens | {camera.lens.name}, focal length {result.scene.instrument.focal_length_mm:.2f} mm |",
        f"| detector | {chip.name}, {chip.gain_dn_per_e:g} DN per electron, read noise {chip.read_noise_e:g} e-, full "
        f"well {chip.full_well_e:g} e-, {chip.adc_bits} bit |",
        f"| exposure | {settings.exposure_s:g} s, band {band}, chip at {settings.chip_temperature_c:g} C |",
        f"| stars | {result.scene.catalogue.catalog.name} to {result.scene.faintest_mag:g} mag "
        f"({result.scene.catalogue.catalog.magnitude_system}), epoch {result.config.sky.epoch_year:g}, "
        f"observer: {result.config.sky.observer} |",
        f"| attitudes | {_attitudes(result)} |",
        f"| other light | {_other_light(result)} |",
        f"| radiation | {_radiation(result)} |",
        f"| seed | {result.config.seed} |",
    ]
    return "\n".join(lines)


def _attitudes(result: Result) -> str:
    config = result.config
    words = {
        "sky": "uniform over all rotations",
        "cone": "boresights uniform over a cone",
        "list": "a list",
        "scan": f"a scan at {getattr(config.pointing, 'frame_rate_hz', 0.0):g} frames per second",
    }[config.pointing.kind]
    fastest = max(math.hypot(*one.rate_deg_per_s) for one in result.facts)
    moving = f", turning by up to {fastest:.3g} deg/s" if fastest else ", at rest"
    shutter = f", rolling shutter of {config.camera.line_time_us:g} us per row" if config.camera.line_time_us else ""
    jitter = ""
    if result.scene.plan.jitter is not None:
        rms = ", ".join(f"{value:.3g}" for value in result.scene.plan.jitter.rms_arcsec)
        jitter = f", jitter of {rms} arcsec RMS about x, y, z"
    return f"{words}{moving}{jitter}{shutter}"


def _other_light(result: Result) -> str:
    background = result.config.background
    parts = [f"{background.extra_e_per_s:g} e-/s per pixel"] if background.extra_e_per_s else []
    parts += ["zodiacal light"] if background.zodiacal else []
    if background.uniform_mag_per_arcsec2 is not None:
        parts.append(f"a uniform sky of V = {background.uniform_mag_per_arcsec2:g} mag/arcsec2")
    if background.moon_planets:
        parts.append("Moon and planets (a disk larger than a pixel has no row in the truth; the Sun is never rendered)")
    return ", ".join(parts) or "none"


def _radiation(result: Result) -> str:
    radiation = result.config.radiation
    parts = [] if radiation.environment == "none" else [f"cosmic rays ({radiation.environment})"]
    if radiation.displacement_dose_tev_per_g:
        parts.append(f"displacement damage of {radiation.displacement_dose_tev_per_g:g} TeV/g")
    return ", ".join(parts) or "none"


def _half_fields(result: Result) -> tuple[float, float]:
    """Tangent of half the field along columns and rows, from the world coordinates at the boresight."""
    wcs, camera = result.scene.wcs, result.scene.instrument.camera
    scale = np.sqrt(abs(np.linalg.det(wcs.linear)))
    return float(scale * camera.width_px / 2), float(scale * camera.height_px / 2)


def _reading(result: Result) -> str:
    read = "read_table" if result.config.files.truth == "parquet" else "Table.read"
    if read == "read_table":
        lines = [
            "import pyarrow.parquet as pq",
            "from astropy.io import fits",
            "",
            'index = pq.read_table("index.parquet").to_pylist()',
            "one = index[0]",
            f'dn = fits.getdata(one["file"]{_extension(result)}).astype(float)     # dn[row, column]',
            'stars = pq.read_table(one["truth"]).to_pydict()    # stars["photon_x_px"][0] is a column',
        ]
    else:
        lines = [
            "from astropy.io import fits",
            "from astropy.table import Table",
            "",
            'index = Table.read("index.ecsv")',
            "one = index[0]",
            f'dn = fits.getdata(one["file"]{_extension(result)}).astype(float)     # dn[row, column]',
            'stars = Table.read(one["truth"])                   # stars["photon_x_px"][0] is a column',
        ]
    return "\n".join(["## Reading it", "", "```python", *lines, "```"])


def _extension(result: Result) -> str:
    return "" if result.config.files.compression == "none" else ", 1"


def _folder(result: Result) -> str:
    form = result.config.files.truth
    rows = [
        ("frames/frame_000000.fits", "16 bit, header with exposure, gain, attitude and world coordinates (TAN-SIP)"),
        (f"truth/frame_000000.{form}", "one row per star; facts of the frame as JSON, metadata key `starbench_frame`"),
        (f"index.{form}", "one row per frame: split, files, attitude, rate, digest"),
        (IDENTITY, "configuration and software that the frames depend on"),
        ("contact_sheet.png", "a first look"),
        ("report.html, summary.json, provenance.json", "what was found in the frames, and how they were made"),
    ]
    rows += [(f"{name}/", text) for name, text in result.exports.items()]
    return "\n".join(["## Files", "", "| file | holds |", "|---|---|", *(f"| `{a}` | {b} |" for a, b in rows)])


def _conventions() -> str:
    return """## Conventions

* Pixels: x = column, y = row, an integer is the **centre** of a pixel, arrays are `dn[row, column]`. FITS pixels
  (header, DS9) are one larger in both.
* `cam`: right-handed, +Z along the boresight into the sky, +X along increasing column, +Y along increasing row.
  `icrs`: the sky. `v_cam = R v_icrs`; quaternions are cam from icrs, scalar last, w >= 0.
* Roll is the position angle of *up* in the image (towards smaller rows), from north through east. At roll 0 north is
  up and east is left.
* Rates are in camera axes; R(t + dt) = exp(-rate dt) R(t). Attitude and rate are those of the middle of the exposure.
* Three true positions: `chief` is the ray through the centre of the stop, `bundle` the mean of all traced rays,
  `photon` the centroid of the noiseless light after charge diffusion. Compare a centroid with `photon`.
* Electrons are expectations, without noise: in = detector + vignetted + off edge. The signal in DN is electrons x gain
  + offset.
* Directions are those in which the stars are *seen*; without an observer they are barycentric, at the epoch given."""


def _columns() -> str:
    def table(columns: Sequence[Column]) -> list[str]:
        rows = [f"| `{c.name}` | {c.type} | {c.unit} | {c.about} |" for c in columns]
        return ["| column | type | unit | holds |", "|---|---|---|---|", *rows]

    flags = [f"| {bit} | `{name}` | {about} |" for name, (bit, about) in FLAGS.items()]
    return "\n".join(
        [
            "## Truth",
            "",
            *table(COLUMNS),
            "",
            "`flags` is the sum of:",
            "",
            "| bit | name | meaning |",
            "|---|---|---|",
            *flags,
            "",
            "The footprint of a star reaches 3 standard deviations of its spot and half a pixel from its photon "
            "centroid; the variance of the spot is that of its rays, of the charge diffusion and of a pixel.",
            "",
            "## Index",
            "",
            *table(INDEX_COLUMNS),
        ]
    )


def _origin(result: Result) -> str:
    catalogue = result.scene.catalogue.catalog
    notes = "".join(f"\n* {note}" for note in catalogue.notes)
    return f"""## Where it comes from

Stars: {catalogue.source}. {catalogue.attribution}
{notes}

Variability and binary companions are left out. Light is rays: no diffraction, no ghosts, no stray light.

Made by starbench, `python -m experiments.dataset`. A frame is a function of the configuration below and its number: the
same bytes on the same kind of machine, alone, in any order, by any number of workers.

```
{_listed(identity(result.config))}
```"""


def _listed(value: dict[str, Any], key: str = "") -> str:
    lines = []
    for name, item in value.items():
        path = f"{key}{name}"
        lines.append(_listed(item, f"{path}.") if isinstance(item, dict) else f"{path} = {item}")
    return "\n".join(lines)
