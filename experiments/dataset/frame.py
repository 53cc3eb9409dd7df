"""One frame with its truth: a pure function of configuration and frame number; and the cards of its header."""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.plan import FramePlan, plan_frame
from experiments.dataset.scene import PLANET_IDS, DatasetScene
from experiments.dataset.truth import FLAGS, FrameGhost, PointSources, pixel_flags, star_rows
from experiments.harness.outputs import PROGRAM
from experiments.harness.registry import version_of
from optics.arrays import FloatArray
from optics.attitude import angles_from_attitude, quat_xyzw
from optics.units import RAD_DEG
from render.fits.headers import Card
from render.observation import BodyDisk, SkyLight
from render.records import Frame
from render.sensor_file.instrument import Instrument

LAYER_WORDS = {
    "stars": "stars and planets smaller than a pixel",
    "scatter": "halos of stars: polish and dust of the lens",
    "ghosts": "ghosts: light reflected by two surfaces",
    "sky": "zodiacal light, uniform sky",
    "stray": "uniform stray light of Sun, Moon and Earth outside the field",
    "bodies": "Moon and planets larger than a pixel",
    "dark": "dark current and uniform light of background.extra_e_per_s",
}
"""Layers of a frame; all but ``dark`` add up to the light on the detector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedFrame:
    """A frame before writing."""

    plan: FramePlan
    frame: Frame
    truth: dict[str, Any]  # Columns of the truth (`experiments.dataset.truth.COLUMNS`)
    background_e: float  # Mean expected electrons per pixel of sky light
    saturated_px: int  # Number of saturated pixels
    disks: tuple[BodyDisk, ...] = ()  # Bodies larger than a pixel
    cosmic_rays: NDArray[np.bool_] | None = None  # (h, w) Pixels with at least an electron of cosmic rays
    layers: dict[str, NDArray[np.float32]] | None = None  # Expected electrons by source
    ghosts: tuple[FrameGhost, ...] = ()

    @property
    def stars(self) -> int:
        """Stars of which light reaches the detector."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["no_light"][0] == 0))

    @property
    def saturated(self) -> int:
        """Stars with a saturated pixel."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["saturated"][0]))


class FrameRenderer:
    """Renders frames of a dataset; a frame depends on the scene and the frame number alone."""

    def __init__(self, scene: DatasetScene) -> None:
        self.scene = scene
        self._lags = scene.instrument.detector.lag > 0.0 and scene.plan.trajectory is not None
        self._last: tuple[int, SkyLight] | None = None

    def render(self, frame: int) -> RenderedFrame:
        """Frame number ``frame``, up to 2^40 and more."""
        scene, simulator = self.scene, self.scene.simulator
        before = self._previous_light(frame)
        plan = plan_frame(scene.plan, frame)
        light = self._light(plan)
        if self._lags:
            self._last = frame, light
        hits = simulator.hits(frame)
        cosmic_rays = None if hits is None else hits.hit_mask
        read = simulator.read(light, frame=frame, before=before)
        sources = _point_sources(scene, light)
        sky_e = simulator.background_e_per_s * light.exposure_s + sum(
            float(light.layers[name].mean()) for name in ("sky", "stray") if name in light.layers
        )
        truth = star_rows(
            sources,
            light.truth,
            frame=frame,
            band=light.band,
            blur_px=scene.instrument.camera.blur_px,
            background_e2=float(scene.instrument.pixel_noise().temporal_e2(sky_e)),
            bits=pixel_flags(read.saturated, read.defect, cosmic_rays),
            smear_px=self._smear_px(sources, plan, light),
            axial_transmission=simulator.axial_transmission,
        )
        return RenderedFrame(
            plan=plan,
            frame=read,
            truth=truth,
            background_e=sky_e,
            saturated_px=int(np.count_nonzero(read.saturated)),
            disks=light.disks,
            cosmic_rays=cosmic_rays,
            layers=light.layers | {"dark": simulator.dark_electrons()} if scene.config.files.layers else None,
            ghosts=_named_ghosts(light),
        )

    def _light(self, plan: FramePlan) -> SkyLight:
        label = f"frame_{plan.frame:06d}"
        if plan.trajectory is None:
            return self.scene.simulator.expected(plan.attitude, label=label)
        return self.scene.simulator.expected(plan.trajectory, start_s=plan.start_s, label=label)

    def _previous_light(self, frame: int) -> SkyLight | None:
        """Light of the preceding frame, for a detector with lag; None without one."""
        if not self._lags or frame == 0:
            return None
        if self._last is not None and self._last[0] == frame - 1:
            return self._last[1]
        return self._light(plan_frame(self.scene.plan, frame - 1))

    def _smear_px(self, sources: PointSources, plan: FramePlan, light: SkyLight) -> FloatArray:
        if plan.trajectory is None or not len(sources):
            return np.zeros((len(sources), 2))
        return self.scene.simulator.smear_px(
            plan.trajectory, np.array(sources.direction), light.truth.chief_y_px[:, 0], start_s=plan.start_s
        )


def _point_sources(scene: DatasetScene, light: SkyLight) -> PointSources:
    """Names and catalogue values of the sources of a frame."""
    field, planets = light.field, light.planets
    assert field is not None
    names, magnitude_v = ((), np.zeros(0)) if planets is None else (planets.name, planets.magnitude_v)
    return PointSources(
        direction=light.sources.direction,
        star_id=np.concatenate([field.stars.id, np.array([PLANET_IDS[name] for name in names], np.int64)]),
        catalogue_row=np.concatenate([scene.row[field.row], np.full(len(names), -1)]),
        magnitude=np.concatenate([field.stars.magnitude, magnitude_v]),
        temperature_k=np.concatenate([scene.sky.temperature_k[field.row], np.full(len(names), np.nan)]),
    )


def _named_ghosts(light: SkyLight) -> tuple[FrameGhost, ...]:
    """Ghosts in the record of a frame."""
    ghosts, field = light.ghosts, light.field
    if ghosts is None or field is None:
        return ()
    names = [*map(str, field.stars.id.tolist()), *light.sources_outside]
    columns = [field.name for field in fields(FrameGhost) if field.name != "source"]
    rows = zip(ghosts.star.tolist(), *(getattr(ghosts, name).tolist() for name in columns), strict=True)
    return tuple(FrameGhost(source=names[star], **dict(zip(columns, row, strict=True))) for star, *row in rows)


_J2000 = datetime(2000, 1, 1, 12)
_MJD_J2000, _YEAR_DAYS, _DAY_S = 51544.5, 365.25, 86400.0


def header_cards(scene: DatasetScene, rendered: RenderedFrame) -> list[Card]:
    """Header cards: time, instrument, attitude, rate, light, world coordinates; nothing of the machine or its clock."""
    config, plan, path = scene.config, rendered.plan, scene.plan.trajectory
    attitude = plan.attitude
    ra, dec, roll = angles_from_attitude(attitude)
    quaternion = zip("XYZW", quat_xyzw(attitude).tolist(), strict=True)
    rate = zip("XYZ", (plan.rate_rad_per_s * RAD_DEG).tolist(), strict=True)
    # the epoch is the start of a scan, and the middle of any other exposure
    start_s = -0.5 * scene.plan.duration_s if path is None else plan.start_s - path.start_s
    days = (config.catalogue.epoch_year - 2000.0) * _YEAR_DAYS + start_s / _DAY_S
    return [
        ("TIMESYS", "TDB", "time scale of the dates"),
        ("DATE-OBS", (_J2000 + timedelta(days=days)).isoformat(timespec="milliseconds"), "start of the exposure"),
        ("MJD-OBS", _MJD_J2000 + days, "[d] start of the exposure"),
        *instrument_cards(scene.instrument),
        ("SEED", config.seed, "seed of the dataset"),
        ("SPLIT", plan.split, "part of the dataset"),
        ("RA_BORE", ra, "[deg] boresight, middle of the exposure"),
        ("DEC_BORE", dec, "[deg] boresight, middle of the exposure"),
        ("ROLL", roll, "[deg] position angle of up (smaller rows)"),
        *((f"QUAT_{axis}", value, "attitude cam from icrs, scalar last") for axis, value in quaternion),
        *((f"RATE_{axis}", value, "[deg/s] angular velocity in cam") for axis, value in rate),
        ("JYEAR", config.catalogue.epoch_year, "[yr] Julian year of the exposure"),
        ("OBSERVER", config.catalogue.observer, "earth: with parallax and aberration"),
        ("MAGLIMIT", scene.faintest_mag, "[mag] faintest stars rendered"),
        ("SKYLIGHT", rendered.background_e, "[e-] mean expected sky light per pixel"),
        *scene.wcs.header(attitude.as_matrix()),
    ]


def instrument_cards(instrument: Instrument) -> list[Card]:
    """Header cards of lens and detector."""
    camera, chip, config = instrument.camera, instrument.detector, instrument.config
    pitch_um = 1e3 * camera.pixel_pitch_mm
    curve = 1.0 + sum(chip.nonlinearity)  # at the full well
    saturation_dn = min(chip.largest_dn, int(chip.offset_dn + chip.gain_dn_per_e * chip.full_well_e * curve))
    return [
        ("INSTRUME", _ascii(f"{camera.lens.name} + {chip.name}"), "lens and detector"),
        ("LENS", _ascii(camera.lens.name), "lens prescription"),
        ("DETECTOR", _ascii(chip.name), "detector description"),
        ("FOCALLEN", instrument.focal_length_mm, "[mm] scale of the image, design wavelength"),
        ("XPIXSZ", pitch_um, "[um] pixel pitch along columns"),
        ("YPIXSZ", pitch_um, "[um] pixel pitch along rows"),
        ("CCD-TEMP", config.chip_temperature_c, "[C] temperature of the chip"),
        ("SATURATE", saturation_dn, "[DN] full well or end of the converter"),
        ("CREATOR", " ".join(filter(None, (PROGRAM, version_of(PROGRAM)))), "program"),
    ]


def _ascii(text: str) -> str:
    """Header text: printable ASCII, short enough for a card."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)[:60]
