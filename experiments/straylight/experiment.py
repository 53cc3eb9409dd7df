"""Stray light: transmittance by cause, background, frames under the Sun, exclusion angle, effective changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.harness.drawings import curves
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, below, col, numbers_of
from experiments.harness.summary import Measured
from experiments.harness.what_if import REQUIREMENTS, judge
from experiments.straylight.drawing import draw_baffle, draw_causes, draw_frames
from experiments.straylight.frames import SunFields, SunFrames, rms
from experiments.straylight.settings import Config
from experiments.straylight.transmittance import bare_lens, behind_baffle, check_baffle
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import polar_direction
from optics.light.pst import PointSourceTransmittance, read_pst, write_pst
from render.baffle.light import WorstPaths
from render.baffle.transmittance import CAUSES, SensorTransmittance
from render.baffle.vaned_baffle import VanedBaffle
from render.bodies.stray_light import BandLight, band_light, earth_limb_pst
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument
from render.sensor_file.requirements import AT_LEAST
from render.sensor_file.stray import BaffleConfig

LABELS = {
    "ghosts": "Ghosts",
    "polish": "Polished surfaces",
    "dust": "Dust",
    "walls": "Walls and vanes",
    "edges": "Vane edges",
}
LIMB_DEG = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0)


def limits(config: Config) -> dict[str, tuple[float, bool]]:
    """Requirements of the sensor file that are answered here."""
    key, required = "sun_exclusion_deg", config.requirements.sun_exclusion_deg
    return {} if required is None else {key: (float(required), key in AT_LEAST)}


# --- The sensor in words


@dataclass(frozen=True, slots=True, kw_only=True)
class BaffledSensor:
    """What light meets."""

    name: str = col("Sensor")
    baffle: str = col("Baffle")
    coating: str = col("Coating")
    vanes: int = col("Vanes")
    shade_deg: float = col("Shade of the baffle begins at", "deg", ".2f")  # NaN without vanes
    length_mm: float = col("Length of the baffle", "mm", ".1f")
    diameter_mm: float = col("Diameter of the tube", "mm", ".1f")
    entrance_mm: float = col("Radius of the entrance", "mm", ".2f")
    field_deg: float = col("Half angle of the field, corner", "deg", ".2f")
    rays: int = col("Rays through the baffle")
    sun_e: float = col("Sun, electrons per pixel for a PST of 1", "e-", ".3g")
    walls_error_percent: float = col("Standard error of walls and vanes, largest", "percent", ".1f")
    walls_limit_percent: float = col("Standard error requested", "percent", ".1f")
    whole_baffle: bool = col("No baffle was stated")
    stray: SensorTransmittance
    worst: WorstPaths | None
    worst_deg: float
    camera: Any


# --- Point-source transmittance


@dataclass(frozen=True, slots=True, kw_only=True)
class Angle:
    """One angle of the source."""

    angle_deg: float = col("Angle of the source", "deg", "g")
    direct: float = col("Entrance in the light", format=".3f", shown=False)
    pst_cause: FloatArray = col("PST by cause", format=".2e", dims="cause azimuth", shown=False)
    pst: Sequence[Measured] = col("PST", format=".2e", dims="azimuth")
    sun_e: FloatArray = col("Sun", "e-", ".3g", "azimuth")
    moon_e: FloatArray = col("Full Moon", "e-", ".3g", "azimuth", shown=False)
    azimuth_deg: FloatArray  # Of the table


def by_angle(stray: SensorTransmittance, light: BandLight, exposure_s: float) -> list[Angle]:
    """The table, with electrons from Sun and Moon."""
    pst = stray.pst
    total, error = pst.total, pst.total_error
    return [
        Angle(
            angle_deg=float(angle),
            direct=float(stray.direct[0, a]),
            pst_cause=pst.value[:, :, a],
            pst=[Measured(value=float(v), uncertainty=float(e)) for v, e in zip(total[:, a], error[:, a], strict=True)],
            sun_e=total[:, a] * light.sun_e_per_s * exposure_s,
            moon_e=total[:, a] * light.full_moon_e_per_s * exposure_s,
            azimuth_deg=pst.azimuth_deg,
        )
        for a, angle in enumerate(pst.angle_deg)
    ]


# --- The Earth's limb


@dataclass(frozen=True, slots=True, kw_only=True)
class Limb:
    """The limb of the Earth, in full light, at an angle from the boresight."""

    limb_deg: float = col("Limb", "deg", "g")
    earth_e: float = col("Earth", "e-", ".3g")


def limb(config: Config, pst: PointSourceTransmittance, light: BandLight, angles: Sequence[float]) -> list[Limb]:
    """Electrons per pixel by the Earth for a sensor at an altitude."""
    scale = light.sun_e_per_s * config.instrument.exposure_s
    return [Limb(limb_deg=a, earth_e=scale * earth_limb_pst(pst, a, config.earth_altitude_km)) for a in angles]


# --- Frames


@dataclass(frozen=True, slots=True, kw_only=True)
class SunAngle:
    """Frames with the Sun at an angle, mean over the attitudes."""

    sun_deg: float = col("Sun", "deg", ".2f")
    light_e: float = col("Stray light", "e-", ".3g")
    found: Measured = col("Stars detected", format=".1f")
    lost: Measured = col("Lost", "percent", ".1f")
    false: Measured = col("False detections", format=".2f")
    saturated: float = col("Saturated pixels", "percent", ".1f")
    centroid_px: float = col("Centroid, RMS", "px", ".3f")
    solved: float = col("Attitudes solved", "percent", ".0f")
    cross_arcsec: float = col("Attitude across", "arcsec", ".2f")
    roll_arcsec: float = col("Roll", "arcsec", ".2f")
    frames: SunFrames
    usable: bool


def _mean(values: Any) -> Measured:
    known = np.asarray(values, dtype=float)
    error = float(known.std(ddof=1) / math.sqrt(len(known))) if len(known) > 1 else 0.0
    return Measured(value=float(known.mean()), uncertainty=error, n=len(known))


def at_sun(
    config: Config, bench: SunFields, stray: SensorTransmittance, scale_e: float, angle: float, before: SunFrames
) -> SunAngle:
    """Frames with the Sun at an angle."""
    light = scale_e * stray.over_pixels(angle, bench.instrument.detector.shape)
    seen = bench.look(light, "sky", before)
    more = float(seen.false.mean() - before.false.mean())
    full = bench.instrument.detector.full_well_e
    return SunAngle(
        sun_deg=angle,
        light_e=float(light.mean()),
        found=_mean(seen.found),
        lost=_mean(100.0 * seen.lost),
        false=_mean(seen.false),
        saturated=float(100.0 * (light >= full).mean()),
        centroid_px=rms(seen.error_px),
        solved=float(100.0 * seen.solved.mean()),
        cross_arcsec=rms(seen.error_arcsec[:, :2].ravel()),
        roll_arcsec=rms(seen.error_arcsec[:, 2]),
        frames=seen,
        usable=more <= config.rates.false_per_frame and float(seen.lost.mean()) <= config.rates.lost_fraction,
    )


# --- Exclusion angle


@dataclass(frozen=True, slots=True, kw_only=True)
class Exclusion:
    """Angles within which frames are not usable."""

    sun_exclusion_deg: float = col("Exclusion angle of the Sun", "deg", ".2f")
    moon_exclusion_deg: float = col("Exclusion angle of the full Moon", "deg", ".2f")
    earth_exclusion_deg: float = col("Exclusion angle of the Earth's limb", "deg", ".1f")
    critical_e: float = col("Stray light at which frames cease to be usable", "e-", ".3g")
    nearest_usable_deg: float = col("Smallest angle of the Sun with usable frames", "deg", ".2f")
    farthest_unusable_deg: float = col("Largest angle of the Sun without usable frames", "deg", ".2f")
    bounded: bool


def exclusion(
    config: Config,
    stray: SensorTransmittance,
    light: BandLight,
    frames: list[SunAngle],
    look: Callable[[float], SunAngle],
) -> tuple[Exclusion, list[SunAngle]]:
    """The largest angle at which a rate is passed, narrowed down by more frames; its light tells Moon and Earth."""
    rows = sorted(frames, key=lambda one: one.sun_deg)
    bad = [k for k, one in enumerate(rows) if not one.usable]
    bounded = bool(bad) and bad[-1] < len(rows) - 1
    if bounded:
        inner, outer = rows[bad[-1]], rows[bad[-1] + 1]
        for _ in range(REFINED):
            rows.append(middle := look(math.sqrt(inner.sun_deg * outer.sun_deg)))
            inner, outer = (inner, middle) if middle.usable else (middle, outer)
        critical = math.sqrt(max(inner.light_e, 1e-3) * max(outer.light_e, 1e-3))
        angle, usable, unusable = 0.5 * (inner.sun_deg + outer.sun_deg), outer.sun_deg, inner.sun_deg
    elif bad:
        critical, angle, usable, unusable = min(one.light_e for one in rows), 180.0, math.nan, rows[-1].sun_deg
    else:
        critical, angle, usable, unusable = max(one.light_e for one in rows), 0.0, rows[0].sun_deg, 0.0
    earth = limb(config, stray.pst, light, [0.5 * k for k in range(181)])
    return Exclusion(
        sun_exclusion_deg=angle,
        moon_exclusion_deg=float(
            stray.pst.last_angle_deg(critical / (light.full_moon_e_per_s * config.instrument.exposure_s))
        ),
        earth_exclusion_deg=max((one.limb_deg for one in earth if one.earth_e > critical), default=0.0),
        critical_e=critical,
        nearest_usable_deg=usable,
        farthest_unusable_deg=unusable,
        bounded=bounded,
    ), sorted(rows, key=lambda one: one.sun_deg)


FAINTEST_E = 2.0
"""Stray light of the farthest Sun."""
REFINED = 3
"""Halvings between the last angle that is not usable and the next one."""


# --- What if


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A single change at a time."""

    change: str = col("Change")
    outside_pst: float = col("PST 5 deg outside the shade", format=".2e")
    outside_e: float = col("Sun at this angle", "e-", ".3g")
    inside_pst: float = col("PST 5 deg inside", format=".2e")
    exclusion_deg: float = col("Exclusion angle of the Sun", "deg", ".1f")


NEAR_DEG = 7.0
"""Margin inside the shade from which variants are computed."""


def changes(
    config: Config, stray: SensorTransmittance, light: BandLight, critical: float, advance: Callable[[], None]
) -> list[Variant]:
    """Dust, coating and vanes; exclusion angles by the light at which frames cease to be usable."""
    assert stray.lens is not None
    angles = np.array(config.pst.angles_deg)
    scale = light.sun_e_per_s * config.instrument.exposure_s
    tube = None if stray.scene is None else stray.scene.baffle
    shade = 35.0 if tube is None else tube.shade_deg
    chosen = [int(a) for a in np.flatnonzero(angles >= shade - NEAR_DEG)]
    own, rows = config.baffle, []
    variants: list[tuple[str, Any, str]] = [("as it is", own, "dust")]
    variants += [(f"dust of level {key.split()[1]}", own, key) for key in stray.lens.value if key.startswith("dust ")]
    if own.fitted and not own.mesh:
        others = [name for name in ("z306", "black_anodised", "magic_black") if name != own.coating]
        variants += [(f"coating {name}", own.model_copy(update={"coating": name}), "dust") for name in others]
        for label, update in (
            ("edges twice as round", {"edge_radius_um": 2 * own.edge_radius_um}),
            ("no vanes", {"vanes": 0}),
            ("no baffle", {"fitted": False}),
        ):
            variants.append((label, own.model_copy(update=update), "dust"))
    for label, baffle, dust in variants:
        same = baffle is own and dust == "dust"
        pst = stray.pst if same else behind_baffle(config, stray.lens, baffle, dust=dust, chosen=chosen).pst
        outside, inside = pst.at(polar_direction([min(shade + 5.0, 89.0), shade - 5.0])).tolist()
        rows.append(
            Variant(
                change=label,
                outside_pst=outside,
                outside_e=scale * outside,
                inside_pst=inside,
                exclusion_deg=float(pst.last_angle_deg(critical / scale)),
            )
        )
        advance()
    return rows


# --- The run


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Transmittance, background, frames, exclusion angle, variants."""
    instrument = build_instrument(config.instrument)
    light = band_light(instrument.detector, open_band(config.passband, instrument))
    stray = _stray(config, instrument, progress)
    scale = light.sun_e_per_s * config.instrument.exposure_s
    with progress.stage("sky", total=config.frames.attitudes) as stage:
        bench = SunFields(config, instrument, stage.advance)
    before = bench.look(0.0, "sky")
    if not before.found.any():
        raise DomainError(
            "no star is detected in frames without the Sun; lengthen the exposure or lower threshold_sigma"
        )
    # from a few electrons to a full well
    full_e = instrument.detector.full_well_e
    angles = stray.pst.angles_by_value(config.frames.levels, FAINTEST_E / scale, full_e / scale)

    def look(angle: float) -> SunAngle:
        return at_sun(config, bench, stray, scale, angle, before)

    rows = []
    with progress.stage("frames", total=len(angles) + REFINED) as stage:
        for angle in angles:
            rows.append(look(angle))
            stage.advance()
        excluded, rows = exclusion(config, stray, light, rows, look)
    found = None
    if config.what_if and stray.lens is not None:
        with progress.stage("what if", total=9) as stage:
            found = changes(config, stray, light, excluded.critical_e, stage.advance)
    required = judge(limits(config), numbers_of(excluded))
    return {
        "setup": _setup(config, instrument, stray, scale),
        "requirements": required or None,
        "pst": by_angle(stray, light, config.instrument.exposure_s),
        "limb": limb(config, stray.pst, light, LIMB_DEG),
        "frames": rows,
        "exclusion": excluded,
        "changes": found,
    }


def _stray(config: Config, instrument: Instrument, progress: Progress) -> SensorTransmittance:
    if config.pst.file:
        pst = read_pst(config.pst.file)
        return SensorTransmittance(pst=pst, direct=np.ones(pst.total.shape))
    check_baffle(config, instrument)
    count = len(config.pst.angles_deg) * len(config.pst.azimuths_deg)
    with progress.stage("lens", total=count) as stage:
        lens = bare_lens(config, instrument, stage.advance)
    with progress.stage("baffle", total=count) as stage:
        return behind_baffle(config, lens, config.baffle, advance=stage.advance)


def _setup(config: Config, instrument: Instrument, stray: SensorTransmittance, scale: float) -> BaffledSensor:
    baffle, nothing = None if stray.scene is None else stray.scene.baffle or stray.scene.mesh, math.nan
    vaned = baffle if isinstance(baffle, VanedBaffle) else None
    words = "none"
    if vaned is not None:
        words = f"tube of {vaned.length_mm:.1f} mm with {len(vaned.vane_z_mm)} vanes"
    elif baffle is not None:
        words = Path(config.baffle.mesh).name
    elif config.pst.file:
        words = "part of the table"
    worst, worst_deg = None, nothing
    if stray.scene is not None:
        worst_deg = min(vaned.shade_deg + 5.0, 85.0) if vaned is not None else 45.0
        assert stray.weight is not None
        worst = stray.scene.worst_paths(polar_direction(worst_deg), stray.weight)
    coating = "" if stray.scene is None else f"{stray.scene.coating.name}: {stray.scene.coating.source}"
    return BaffledSensor(
        name=config.name or f"{instrument.camera.lens.name} on {instrument.detector.name}",
        baffle=words,
        coating=coating,
        vanes=0 if vaned is None else len(vaned.vane_z_mm),
        shade_deg=nothing if vaned is None else vaned.shade_deg,
        length_mm=nothing if vaned is None else vaned.length_mm,
        diameter_mm=nothing if vaned is None else 2.0 * vaned.tube_mm,
        entrance_mm=nothing if stray.lens is None else stray.lens.entrance_mm,
        field_deg=0.5 * math.hypot(*instrument.field_deg),
        rays=stray.rays,
        sun_e=scale,
        walls_error_percent=stray.worst_percent,
        walls_limit_percent=100.0 * config.pst.walls_error,
        whole_baffle=config.baffle == BaffleConfig(),
        stray=stray,
        worst=worst,
        worst_deg=worst_deg,
        camera=instrument.camera,
    )


def save_table(result: dict[str, Any], folder: Path) -> None:
    """``pst.ecsv``, for ``observe(stray_light=)`` and ``dataset``."""
    write_pst(folder / "pst.ecsv", result["setup"].stray.pst)


def _pst_axes(q: Quantities, found: Sequence[Angle]) -> None:
    causes = len(found[0].pst_cause)
    names = list(CAUSES) if causes == len(CAUSES) else [f"cause_{n}" for n in range(causes)]
    q.axis("cause", np.array(names, dtype=object), "Cause", names=[LABELS.get(one, one) for one in names])
    azimuth = found[0].azimuth_deg
    q.axis("azimuth", azimuth, "Azimuth", unit="deg", format="g", names=[f"at azimuth {one:g}°" for one in azimuth])


SECTIONS = {
    "setup": Section(
        record=BaffledSensor,
        figures={"baffle": draw_baffle},
        verdicts=[
            below(
                "walls_error_percent",
                "walls_limit_percent",
                title="light of walls and vanes: standard error",
                advice="the limit of passes is reached: light of this baffle follows rare paths",
            )
        ],
    ),
    "requirements": REQUIREMENTS,
    "pst": Section(
        record=Angle,
        dim="angle",
        along="angle_deg",
        axes=_pst_axes,
        table="transmittance",
        across="azimuth",
        columns="pst sun_e",
        caption="Point-source transmittance against the angle of the source, and electrons per pixel by the Sun.",
        figures={"causes": draw_causes},
    ),
    "limb": Section(
        record=Limb,
        dim="limb",
        along="limb_deg",
        caption="Electrons per pixel from the fully lit Earth.",
    ),
    "frames": Section(
        record=SunAngle,
        dim="sun",
        along="sun_deg",
        caption="Frames of the real sky by angle of the Sun, mean over the attitudes.",
        figures={
            "rates": curves("light_e", points="lost", log="x", y="Stars lost", aspect_ratio=0.8, width="half"),
            "attitude": curves(
                "light_e",
                lines="cross_arcsec roll_arcsec",
                log="xy",
                y="Attitude, RMS",
                aspect_ratio=0.8,
                width="half",
            ),
            "looks": draw_frames,
        },
    ),
    "exclusion": Section(
        record=Exclusion, vertical=True, caption="Exclusion angles."
    ),
    "changes": Section(
        record=Variant,
        note="Exclusion angle: where the Sun's light falls to the tolerated light; end of the table: at no angle.",
        dim="variant",
        table="what_if",
        rows="variant",
        hidden="variant",
        caption="A single change at a time.",
    ),
}  # fmt: skip
