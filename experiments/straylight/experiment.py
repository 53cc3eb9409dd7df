"""Stray light: transmittance by cause, background, frames in sunlight, exclusion angles, variants of the baffle."""

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
from experiments.straylight.settings import StraylightConfig
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
FAINTEST_E = 2.0
"""Stray light at the largest angle of the Sun."""
BISECTIONS = 3
"""Additional Sun angles between the largest unusable and the smallest usable angle."""
MIN_CRITICAL_E = 1e-3
"""Floor of the stray light in geometric means."""
LIMB_STEP_DEG = 0.5
"""Resolution of the exclusion angle of the Earth's limb."""
NO_VANES_SHADE_DEG = 35.0
"""Shade angle of the variants for a sensor without vanes."""
LIMB_DEG = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0)


def limits(config: StraylightConfig) -> dict[str, tuple[float, bool]]:
    """Requirements of the sensor file that this experiment predicts."""
    key, required = "sun_exclusion_deg", config.requirements.sun_exclusion_deg
    return {} if required is None else {key: (float(required), key in AT_LEAST)}


# --- Sensor and baffle


@dataclass(frozen=True, slots=True, kw_only=True)
class BaffledSensor:
    """Sensor, baffle and accuracy of the transmittance."""

    name: str = col("Sensor")
    baffle: str = col("Baffle")
    coating: str = col("Coating")
    vanes: int = col("Vanes")
    shade_deg: float = col("Shade of the baffle begins at", "deg", ".2f")  # NaN without vanes
    baffle_length_mm: float = col("Length of the baffle", "mm", ".1f")
    tube_diameter_mm: float = col("Diameter of the tube", "mm", ".1f")
    entrance_radius_mm: float = col("Radius of the entrance", "mm", ".2f")
    half_field_deg: float = col("Half angle of the field, corner", "deg", ".2f")
    rays: int = col("Rays through the baffle")
    sun_e_at_unit_pst: float = col("Sun, electrons per pixel for a PST of 1", "e-", ".3g")
    walls_error_percent: float = col("Standard error of walls and vanes, largest", "percent", ".1f")
    walls_limit_percent: float = col("Standard error requested", "percent", ".1f")
    default_baffle: bool = col("No baffle was stated")
    stray: SensorTransmittance
    worst: WorstPaths | None
    worst_deg: float
    camera: Any


# --- Point-source transmittance


@dataclass(frozen=True, slots=True, kw_only=True)
class PstAngle:
    """Transmittance at an angle of the source."""

    angle_deg: float = col("Angle of the source", "deg", "g")
    sunlit_fraction: float = col("Sunlit fraction of the entrance", format=".3f", shown=False)
    by_cause: FloatArray = col("PST by cause", format=".2e", dims="cause azimuth", shown=False)
    total: Sequence[Measured] = col("PST", format=".2e", dims="azimuth")
    sun_e: FloatArray = col("Sun", "e-", ".3g", "azimuth")
    moon_e: FloatArray = col("Full Moon", "e-", ".3g", "azimuth", shown=False)
    azimuth_deg: FloatArray


def tabulate_pst(stray: SensorTransmittance, light: BandLight, exposure_s: float) -> list[PstAngle]:
    """PST by angle, and electrons per pixel from Sun and Moon."""
    pst = stray.pst
    value, error = pst.total, pst.total_error
    return [
        PstAngle(
            angle_deg=float(angle),
            sunlit_fraction=float(stray.direct[0, a]),
            by_cause=pst.value[:, :, a],
            total=[
                Measured(value=float(v), uncertainty=float(e)) for v, e in zip(value[:, a], error[:, a], strict=True)
            ],
            sun_e=value[:, a] * light.sun_e_per_s * exposure_s,
            moon_e=value[:, a] * light.full_moon_e_per_s * exposure_s,
            azimuth_deg=pst.azimuth_deg,
        )
        for a, angle in enumerate(pst.angle_deg)
    ]


# --- The Earth's limb


@dataclass(frozen=True, slots=True, kw_only=True)
class EarthLimb:
    """Stray light of the fully lit Earth, its limb at an angle from the boresight."""

    limb_deg: float = col("Limb", "deg", "g")
    earth_e: float = col("Earth", "e-", ".3g")


def limb_background(
    config: StraylightConfig, pst: PointSourceTransmittance, light: BandLight, angles: Sequence[float]
) -> list[EarthLimb]:
    """Electrons per pixel from the Earth at the altitude of the sensor."""
    scale = light.sun_e_per_s * config.instrument.exposure_s
    return [EarthLimb(limb_deg=a, earth_e=scale * earth_limb_pst(pst, a, config.earth_altitude_km)) for a in angles]


# --- Frames


@dataclass(frozen=True, slots=True, kw_only=True)
class SunAngle:
    """Frames with the Sun at an angle, means over the attitudes."""

    sun_deg: float = col("Sun", "deg", ".2f")
    stray_light_e: float = col("Stray light", "e-", ".3g")
    stars_per_frame: Measured = col("Stars detected", format=".1f")
    lost_percent: Measured = col("Lost", "percent", ".1f")
    false_per_frame: Measured = col("False detections", format=".2f")
    saturated_percent: float = col("Saturated pixels", "percent", ".1f")
    centroid_error_px: float = col("Centroid, RMS", "px", ".3f")
    solved_percent: float = col("Attitudes solved", "percent", ".0f")
    attitude_cross_arcsec: float = col("Attitude across", "arcsec", ".2f")
    attitude_roll_arcsec: float = col("Roll", "arcsec", ".2f")
    frames: SunFrames
    usable: bool


def _mean(values: Any) -> Measured:
    sample = np.asarray(values, dtype=float)
    error = float(sample.std(ddof=1) / math.sqrt(len(sample))) if len(sample) > 1 else 0.0
    return Measured(value=float(sample.mean()), uncertainty=error, n=len(sample))


def measure_sun_angle(
    config: StraylightConfig,
    fields: SunFields,
    stray: SensorTransmittance,
    scale_e: float,
    angle: float,
    dark: SunFrames,
) -> SunAngle:
    """Frames with the Sun at an angle, against ``dark``: without it."""
    light = scale_e * stray.over_pixels(angle, fields.instrument.detector.shape)
    frames = fields.observe(light, "sky", dark)
    added_false = float(frames.false.mean() - dark.false.mean())
    full_well_e = fields.instrument.detector.full_well_e
    return SunAngle(
        sun_deg=angle,
        stray_light_e=float(light.mean()),
        stars_per_frame=_mean(frames.stars),
        lost_percent=_mean(100.0 * frames.lost_fraction),
        false_per_frame=_mean(frames.false),
        saturated_percent=float(100.0 * (light >= full_well_e).mean()),
        centroid_error_px=rms(frames.error_px),
        solved_percent=float(100.0 * frames.solved.mean()),
        attitude_cross_arcsec=rms(frames.error_arcsec[:, :2].ravel()),
        attitude_roll_arcsec=rms(frames.error_arcsec[:, 2]),
        frames=frames,
        usable=added_false <= config.rates.false_per_frame
        and float(frames.lost_fraction.mean()) <= config.rates.lost_fraction,
    )


# --- Exclusion angle


@dataclass(frozen=True, slots=True, kw_only=True)
class Exclusion:
    """Angles within which frames are not usable."""

    sun_exclusion_deg: float = col("Exclusion angle of the Sun", "deg", ".2f")
    moon_exclusion_deg: float = col("Exclusion angle of the full Moon", "deg", ".2f")
    earth_exclusion_deg: float = col("Exclusion angle of the Earth's limb", "deg", ".1f")
    critical_stray_light_e: float = col("Stray light at which frames cease to be usable", "e-", ".3g")
    nearest_usable_deg: float = col("Smallest angle of the Sun with usable frames", "deg", ".2f")
    farthest_unusable_deg: float = col("Largest angle of the Sun without usable frames", "deg", ".2f")
    bounded: bool


def find_exclusion(
    config: StraylightConfig,
    stray: SensorTransmittance,
    light: BandLight,
    frames: list[SunAngle],
    observe: Callable[[float], SunAngle],
) -> tuple[Exclusion, list[SunAngle]]:
    """Largest Sun angle with unusable frames, by bisection with further frames; Moon and Earth at equal light."""
    rows = sorted(frames, key=lambda row: row.sun_deg)
    unusable_rows = [k for k, row in enumerate(rows) if not row.usable]
    bounded = bool(unusable_rows) and unusable_rows[-1] < len(rows) - 1
    if bounded:
        unusable, usable = rows[unusable_rows[-1]], rows[unusable_rows[-1] + 1]
        for _ in range(BISECTIONS):
            rows.append(middle := observe(math.sqrt(unusable.sun_deg * usable.sun_deg)))
            unusable, usable = (unusable, middle) if middle.usable else (middle, usable)
        critical_e = math.sqrt(max(unusable.stray_light_e, MIN_CRITICAL_E) * max(usable.stray_light_e, MIN_CRITICAL_E))
        exclusion_deg = 0.5 * (unusable.sun_deg + usable.sun_deg)
        usable_deg, unusable_deg = usable.sun_deg, unusable.sun_deg
    elif unusable_rows:  # no angle is usable
        critical_e = min(row.stray_light_e for row in rows)
        exclusion_deg = 180.0
        usable_deg, unusable_deg = math.nan, rows[-1].sun_deg
    else:  # every angle is usable
        critical_e = max(row.stray_light_e for row in rows)
        exclusion_deg = 0.0
        usable_deg, unusable_deg = rows[0].sun_deg, 0.0
    critical_moon_pst = critical_e / (light.full_moon_e_per_s * config.instrument.exposure_s)
    limb_deg = np.arange(0.0, 90.0 + LIMB_STEP_DEG, LIMB_STEP_DEG).tolist()
    earth = limb_background(config, stray.pst, light, limb_deg)
    return Exclusion(
        sun_exclusion_deg=exclusion_deg,
        moon_exclusion_deg=float(stray.pst.last_angle_deg(critical_moon_pst)),
        earth_exclusion_deg=max((row.limb_deg for row in earth if row.earth_e > critical_e), default=0.0),
        critical_stray_light_e=critical_e,
        nearest_usable_deg=usable_deg,
        farthest_unusable_deg=unusable_deg,
        bounded=bounded,
    ), sorted(rows, key=lambda row: row.sun_deg)


# --- What if


@dataclass(frozen=True, slots=True, kw_only=True)
class BaffleVariant:
    """Sensor with a single change."""

    change: str = col("Change")
    outside_pst: float = col("PST 5 deg outside the shade", format=".2e")
    outside_e: float = col("Sun at this angle", "e-", ".3g")
    inside_pst: float = col("PST 5 deg inside", format=".2e")
    exclusion_deg: float = col("Exclusion angle of the Sun", "deg", ".1f")


MARGIN_DEG = 7.0
"""Variants are computed from this margin inside the shade angle on."""


def compare_variants(
    config: StraylightConfig, stray: SensorTransmittance, light: BandLight, critical: float, advance: Callable[[], None]
) -> list[BaffleVariant]:
    """Variants of dust, coating and vanes; exclusion angles at the critical stray light."""
    assert stray.lens is not None
    angles = np.array(config.pst.angles_deg)
    scale = light.sun_e_per_s * config.instrument.exposure_s
    tube = None if stray.scene is None else stray.scene.baffle
    shade_deg = NO_VANES_SHADE_DEG if tube is None else tube.shade_deg
    chosen = [int(a) for a in np.flatnonzero(angles >= shade_deg - MARGIN_DEG)]
    stated = config.baffle
    rows: list[BaffleVariant] = []
    variants: list[tuple[str, Any, str]] = [("as it is", stated, "dust")]
    variants += [
        (f"dust of level {key.split()[1]}", stated, key) for key in stray.lens.value if key.startswith("dust ")
    ]
    if stated.fitted and not stated.mesh:
        others = [name for name in ("z306", "black_anodised", "magic_black") if name != stated.coating]
        variants += [(f"coating {name}", stated.model_copy(update={"coating": name}), "dust") for name in others]
        for label, update in (
            ("edges twice as round", {"edge_radius_um": 2 * stated.edge_radius_um}),
            ("no vanes", {"vanes": 0}),
            ("no baffle", {"fitted": False}),
        ):
            variants.append((label, stated.model_copy(update=update), "dust"))
    for label, baffle, dust in variants:
        unchanged = baffle is stated and dust == "dust"
        pst = stray.pst if unchanged else behind_baffle(config, stray.lens, baffle, dust=dust, chosen=chosen).pst
        outside, inside = pst.at(polar_direction([min(shade_deg + 5.0, 89.0), shade_deg - 5.0])).tolist()
        rows.append(
            BaffleVariant(
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


def run(config: StraylightConfig, *, progress: Progress) -> dict[str, Any]:
    """Transmittance, background, frames in sunlight, exclusion angles, variants."""
    instrument = build_instrument(config.instrument)
    light = band_light(instrument.detector, open_band(config.passband, instrument))
    stray = _stray(config, instrument, progress)
    scale = light.sun_e_per_s * config.instrument.exposure_s
    with progress.stage("sky", total=config.frames.attitudes) as stage:
        fields = SunFields(config, instrument, stage.advance)
    dark = fields.observe(0.0, "sky")
    if not dark.stars.any():
        raise DomainError(
            "no star is detected in frames without the Sun; lengthen the exposure or lower threshold_sigma"
        )
    full_e = instrument.detector.full_well_e
    angles = stray.pst.angles_by_value(config.frames.levels, FAINTEST_E / scale, full_e / scale)

    def observe(angle: float) -> SunAngle:
        return measure_sun_angle(config, fields, stray, scale, angle, dark)

    rows = []
    with progress.stage("frames", total=len(angles) + BISECTIONS) as stage:
        for angle in angles:
            rows.append(observe(angle))
            stage.advance()
        excluded, rows = find_exclusion(config, stray, light, rows, observe)
    variants = None
    if config.what_if and stray.lens is not None:
        with progress.stage("what if", total=9) as stage:
            variants = compare_variants(config, stray, light, excluded.critical_stray_light_e, stage.advance)
    required = judge(limits(config), numbers_of(excluded))
    return {
        "sensor": _baffled_sensor(config, instrument, stray, scale),
        "requirements": required or None,
        "pst": tabulate_pst(stray, light, config.instrument.exposure_s),
        "limb": limb_background(config, stray.pst, light, LIMB_DEG),
        "frames": rows,
        "exclusion": excluded,
        "changes": variants,
    }


def _stray(config: StraylightConfig, instrument: Instrument, progress: Progress) -> SensorTransmittance:
    if config.pst.file:
        pst = read_pst(config.pst.file)
        return SensorTransmittance(pst=pst, direct=np.ones(pst.total.shape))
    check_baffle(config, instrument)
    count = len(config.pst.angles_deg) * len(config.pst.azimuths_deg)
    with progress.stage("lens", total=count) as stage:
        lens = bare_lens(config, instrument, stage.advance)
    with progress.stage("baffle", total=count) as stage:
        return behind_baffle(config, lens, config.baffle, advance=stage.advance)


def _baffled_sensor(
    config: StraylightConfig, instrument: Instrument, stray: SensorTransmittance, scale: float
) -> BaffledSensor:
    baffle = None if stray.scene is None else stray.scene.baffle or stray.scene.mesh
    vaned = baffle if isinstance(baffle, VanedBaffle) else None
    description = "none"
    if vaned is not None:
        description = f"tube of {vaned.length_mm:.1f} mm with {len(vaned.vane_z_mm)} vanes"
    elif baffle is not None:
        description = Path(config.baffle.mesh).name
    elif config.pst.file:
        description = "part of the table"
    worst, worst_deg = None, math.nan
    if stray.scene is not None:
        worst_deg = min(vaned.shade_deg + 5.0, 85.0) if vaned is not None else 45.0
        assert stray.weight is not None
        worst = stray.scene.worst_paths(polar_direction(worst_deg), stray.weight)
    coating = "" if stray.scene is None else f"{stray.scene.coating.name}: {stray.scene.coating.source}"
    return BaffledSensor(
        name=config.name or f"{instrument.camera.lens.name} on {instrument.detector.name}",
        baffle=description,
        coating=coating,
        vanes=0 if vaned is None else len(vaned.vane_z_mm),
        shade_deg=math.nan if vaned is None else vaned.shade_deg,
        baffle_length_mm=math.nan if vaned is None else vaned.length_mm,
        tube_diameter_mm=math.nan if vaned is None else 2.0 * vaned.tube_mm,
        entrance_radius_mm=math.nan if stray.lens is None else stray.lens.entrance_mm,
        half_field_deg=0.5 * math.hypot(*instrument.field_deg),
        rays=stray.rays,
        sun_e_at_unit_pst=scale,
        walls_error_percent=stray.worst_percent,
        walls_limit_percent=100.0 * config.pst.walls_error,
        default_baffle=config.baffle == BaffleConfig(),
        stray=stray,
        worst=worst,
        worst_deg=worst_deg,
        camera=instrument.camera,
    )


def save_table(result: dict[str, Any], folder: Path) -> None:
    """``pst.ecsv``, for ``observe(stray_light=)`` and ``dataset``."""
    write_pst(folder / "pst.ecsv", result["sensor"].stray.pst)


def _pst_axes(q: Quantities, rows: Sequence[PstAngle]) -> None:
    causes = len(rows[0].by_cause)
    names = list(CAUSES) if causes == len(CAUSES) else [f"cause_{n}" for n in range(causes)]
    q.axis("cause", np.array(names, dtype=object), "Cause", names=[LABELS.get(name, name) for name in names])
    azimuth = rows[0].azimuth_deg
    q.axis("azimuth", azimuth, "Azimuth", unit="deg", format="g", names=[f"at azimuth {angle:g}°" for angle in azimuth])


SECTIONS = {
    "sensor": Section(
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
        record=PstAngle,
        dim="angle",
        along="angle_deg",
        axes=_pst_axes,
        table="transmittance",
        across="azimuth",
        columns="total sun_e",
        caption="Point-source transmittance against the angle of the source, and electrons per pixel by the Sun.",
        figures={"causes": draw_causes},
    ),
    "limb": Section(
        record=EarthLimb,
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
            "rates": curves(
                "stray_light_e", points="lost_percent", log="x", y="Stars lost", aspect_ratio=0.8, width="half"
            ),
            "attitude": curves(
                "stray_light_e",
                lines="attitude_cross_arcsec attitude_roll_arcsec",
                log="xy",
                y="Attitude, RMS",
                aspect_ratio=0.8,
                width="half",
            ),
            "example_frames": draw_frames,
        },
    ),
    "exclusion": Section(
        record=Exclusion, vertical=True, caption="Exclusion angles."
    ),
    "changes": Section(
        record=BaffleVariant,
        note="Exclusion angle: where the Sun's light falls to the tolerated light; end of the table: at no angle.",
        dim="variant",
        table="what_if",
        rows="variant",
        hidden="variant",
        caption="A single change at a time.",
    ),
}  # fmt: skip
