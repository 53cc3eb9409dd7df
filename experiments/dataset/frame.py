"""One frame with its truth: a pure function of configuration and frame number; and the cards of its header."""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import datetime, timedelta
from functools import lru_cache
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.plan import FramePlan, plan_frame
from experiments.dataset.scene import Disk, PointSources, Scene, diffuse_light, point_sources, resolved_light, smear_px
from experiments.dataset.truth import FLAGS, FrameGhost, StarLightOnChip, pixel_flags, star_rows
from optics.attitude import angles_from_attitude, quat_xyzw
from optics.units import RAD_DEG
from render.bodies.ghost_sources import GhostSources
from render.bodies.solar_system import BODIES, hiding_spheres
from render.camera import FAR_NOISE
from render.catalogue.temperature import TYPICAL_TEMPERATURE_K
from render.detector.cosmic_rays import CosmicRayHits, cosmic_ray_hits
from render.detector.maps import dark_electrons
from render.detector.readout import expose
from render.engine.random import Streams
from render.fits.headers import Card
from render.forward import StarRenderer
from render.records import Frame
from render.sensor_file.instrument import Instrument
from render.tracing.ghosts import Ghosting, GhostLight, GhostTruth
from render.tracing.tracer import TracedStars

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
class MadeFrame:
    """A frame before writing."""

    plan: FramePlan  # Attitude, motion, split
    frame: Frame  # Digital numbers
    truth: dict[str, Any]  # Columns of the truth (`experiments.dataset.truth.COLUMNS`)
    background_e: float  # Mean expected electrons per pixel of sky light
    saturated_px: int  # Pixels that are saturated
    disks: tuple[Disk, ...] = ()  # Bodies that are larger than a pixel
    # (h, w) Pixels in which cosmic rays left at least an electron; None where none are asked for
    struck: NDArray[np.bool_] | None = None
    layers: dict[str, NDArray[np.float32]] | None = None  # Expected electrons of every source, where asked for
    ghosts: tuple[FrameGhost, ...] = ()

    @property
    def stars(self) -> int:
        """Stars of which light reaches the detector."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["no_light"][0] == 0))

    @property
    def saturated(self) -> int:
        """Stars with a saturated pixel."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["saturated"][0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Expected:
    """What falls on the detector in a frame."""

    plan: FramePlan
    sources: PointSources
    traced: TracedStars
    layers: dict[str, NDArray[np.float32]]  # Expected electrons of every source
    electrons: NDArray[np.float32]  # Their sum
    sky_e: float
    ghosts: tuple[FrameGhost, ...]
    disks: list[Disk]
    hits: CosmicRayHits | None

    def charge_e(self) -> NDArray[np.float32]:
        """Charge of the frame with cosmic rays [e-]."""
        charge = self.electrons.copy()
        if self.hits is not None:
            np.add.at(charge, (self.hits.row, self.hits.column), self.hits.charge_e.astype(np.float32))
        return charge


class FrameMaker:
    """Makes frames of one dataset; a frame depends on the scene and the frame number alone."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        disks = scene.sky_light.disks
        self._renderer = StarRenderer(
            scene.instrument.camera,
            exposure_s=scene.config.instrument.exposure_s,
            tolerance=scene.config.pupil_tolerance,
            by_grid=True,
            contents=None if disks is None else hiding_spheres(disks),
        )
        self._ghosts = _ghost_sources(scene) if scene.config.background.ghosts else None
        self._bodies = None
        if disks is not None:
            from render.bodies.body_image import BodyRenderer

            self._bodies = BodyRenderer(scene.instrument.camera, scene.sky_light.bands, view=scene.view)
        self._streams: Streams = scene.plan.streams.child("detector")
        self._axis_share = self._share_on_axis()
        self._lags = scene.instrument.detector.lag > 0.0 and scene.plan.path is not None
        self._disks: tuple[bytes, list[Disk]] = b"", []  # of the last camera at rest, whose attitude may come again
        self._last: tuple[int, NDArray[np.float32]] | None = None

    def make(self, frame: int) -> MadeFrame:
        """Frame number ``frame``, up to 2^40 and more."""
        scene, config = self.scene, self.scene.config
        before = self._before(frame)
        expected = self._expected(frame)
        if self._lags:
            self._last = frame, expected.charge_e()
        plan, traced, hits = expected.plan, expected.traced, expected.hits
        struck = None if hits is None else _struck(hits)
        band = scene.light.band[0]
        read = expose(
            expected.electrons,
            scene.instrument.detector,
            streams=self._streams,
            frame=frame,
            exposure_s=config.instrument.exposure_s,
            temperature_c=config.instrument.chip_temperature_c,
            background_e_per_s=config.background.extra_e_per_s,
            band=band,
            hits=hits,
            before=before,
        )
        truth = star_rows(
            expected.sources,
            traced.truth,
            scene.instrument.camera.blur_px,
            frame=frame,
            band=band,
            on_chip=StarLightOnChip(
                empty_e2=float(scene.instrument.pixel_noise().temporal_e2(expected.sky_e)),
                pixel_flags=pixel_flags(read.saturated, read.defect, struck),
                smear_px=smear_px(scene, expected.sources, plan, traced.truth.chief_y_px[:, 0]),
                axis_share=self._axis_share,
            ),
        )
        return MadeFrame(
            plan=plan,
            frame=read,
            truth=truth,
            background_e=expected.sky_e,
            saturated_px=int(np.count_nonzero(read.saturated)),
            disks=tuple(expected.disks),
            struck=struck,
            layers=self._apart(expected) if config.files.layers else None,
            ghosts=expected.ghosts,
        )

    def _apart(self, expected: _Expected) -> dict[str, NDArray[np.float32]]:
        """Layers, and what the detector adds to them."""
        config, detector = self.scene.config, self.scene.instrument.detector
        seconds, celsius, more = (
            config.instrument.exposure_s, config.instrument.chip_temperature_c, config.background.extra_e_per_s
        )  # fmt: skip
        dark = dark_electrons(detector, seconds, temperature_c=celsius, background_e_per_s=more)
        return {**expected.layers, "dark": dark}

    def _expected(self, frame: int) -> _Expected:
        """Stars, sky, disks and cosmic rays of a frame."""
        plan = plan_frame(self.scene.plan, frame)
        sources = point_sources(self.scene, plan)
        self._renderer.label = f"frame_{frame:06d}"
        traced = self._traced(sources, plan)
        layers = {name: light[:, :, 0] for name, light in traced.layers().items()}
        ghosts: tuple[FrameGhost, ...] = ()
        if self._ghosts is not None:
            light = np.zeros_like(traced.electrons)
            ghosts = _named(
                sources, *self._ghosts.add(light, plan.attitude, sources.light, sources.star_id, traced.truth)
            )
            layers["ghosts"] = light[:, :, 0]
        layers |= self._sky(plan)
        background_e = self.scene.config.background.extra_e_per_s * self.scene.config.instrument.exposure_s
        sky_e = background_e + sum(float(layers[name].mean()) for name in ("sky", "stray") if name in layers)
        disks = self._seen_disks(plan)
        if self._bodies is not None:
            layers["bodies"] = np.zeros_like(layers["stars"])
            for disk in disks:
                layers["bodies"] += disk.image.image.electrons[:, :, 0]
        return _Expected(
            plan=plan,
            sources=sources,
            traced=traced,
            layers=layers,
            electrons=np.asarray(sum(layers.values()), np.float32),
            sky_e=sky_e,
            ghosts=ghosts,
            disks=disks,
            hits=self.hits(frame),
        )

    def _before(self, frame: int) -> NDArray[np.float32] | None:
        """Charge of the frame before, of which a detector with lag keeps a share; None without one."""
        if not self._lags or frame == 0:
            return None
        if self._last is not None and self._last[0] == frame - 1:
            return self._last[1]
        return self._expected(frame - 1).charge_e()

    def _share_on_axis(self) -> float:
        """Part of the light of a star on the axis that the lens lets through."""
        star = self.scene.light.stars(np.array([[0.0, 0.0, 1.0]]), 0.0, TYPICAL_TEMPERATURE_K)
        truth = (
            StarRenderer(self.scene.instrument.camera, exposure_s=1.0, tolerance=self.scene.config.pupil_tolerance)
            .trace(star, rotation_cam_from_world=np.eye(3))
            .truth
        )
        return float(1.0 - truth.electrons_vignetted[0, 0] / truth.electrons_in[0, 0])

    def _traced(self, sources: PointSources, plan: FramePlan) -> TracedStars:
        camera = self.scene.config.instrument
        if plan.trajectory is None:
            return self._renderer.trace(sources.light, rotation_cam_from_world=plan.attitude.as_matrix())
        from render.tracing.motion.exposure import exposure_motion

        motion = exposure_motion(
            plan.trajectory,
            start_s=plan.start_s,
            exposure_s=camera.exposure_s,
            camera=self.scene.instrument.camera,
            line_time_s=camera.line_time_us * 1e-6,
            tolerance=self.scene.config.pupil_tolerance,
        )
        return self._renderer.trace(sources.light, motion=motion)

    def _sky(self, plan: FramePlan) -> dict[str, NDArray[np.float32]]:
        """Light of the sky, except what is the same everywhere, and stray light."""
        scene, found = self.scene, dict[str, NDArray[np.float32]]()
        seconds = np.float32(scene.config.instrument.exposure_s)
        if (diffuse := diffuse_light(scene.sky_light, plan.attitude, scene.config)) is not None:
            found["sky"] = diffuse * seconds
        if scene.sky_light.stray is not None:
            stray = sum(scene.sky_light.stray.even(plan.attitude).values())
            found["stray"] = np.full(scene.instrument.detector.shape, stray * seconds, np.float32)
        return found

    def _seen_disks(self, plan: FramePlan) -> list[Disk]:
        """The Moon and planets that are larger than a pixel, with their light."""
        scene = self.scene
        if self._bodies is None:
            return []
        seen = plan.attitude.as_quat().tobytes() if plan.trajectory is None else b""
        if not seen or self._disks[0] != seen:
            self._disks = (
                seen,
                resolved_light(
                    scene.sky_light,
                    self._bodies,
                    plan,
                    scene.config,
                    duration_s=scene.plan.duration_s,
                    full_well_e=scene.instrument.detector.full_well_e,
                ),
            )
        return self._disks[1]

    def hits(self, frame: int) -> CosmicRayHits | None:
        """Charge of cosmic rays in a frame; None without them."""
        radiation = self.scene.config.radiation
        if radiation.environment == "none":
            return None
        return cosmic_ray_hits(
            self.scene.instrument.detector,
            radiation.environment,
            streams=self._streams,
            frame=frame,
            exposure_s=self.scene.config.instrument.exposure_s,
            depth_um=radiation.depth_um,
        )


def _ghost_sources(scene: Scene) -> GhostSources:
    """All that may make ghosts in frames of a dataset."""
    config, stars, sky = scene.config, scene.catalogue.catalog, scene.sky_light
    least_e = FAR_NOISE * max(scene.instrument.detector.read_noise_e, 1.0)
    which = GhostLight(least_e=least_e, detector_reflectance=config.scatter.detector_reflectance)
    return GhostSources(
        Ghosting(scene.instrument.camera, which),
        scene.light.stars(stars.direction, stars.magnitude, scene.temperature_k),
        stars.id,
        exposure_s=config.instrument.exposure_s,
        bands=sky.bands,
        observer=scene.observer,
        epoch_year=config.catalogue.epoch_year,
        bodies=BODIES if config.background.moon_planets else (),
        stray=sky.stray,
    )


def _named(sources: PointSources, ghosts: GhostTruth, beside: tuple[str, ...]) -> tuple[FrameGhost, ...]:
    """Ghosts as the record of a frame lists them."""
    names = [*map(str, sources.star_id.tolist()), *beside]
    columns = {
        field.name: getattr(ghosts, field.name).tolist() for field in fields(FrameGhost) if field.name != "source"
    }
    return tuple(
        FrameGhost(source=names[star], **dict(zip(columns, row, strict=True)))
        for star, *row in zip(ghosts.star.tolist(), *columns.values(), strict=True)
    )


def _struck(hits: CosmicRayHits) -> NDArray[np.bool_]:
    """Pixels (h, w) in which cosmic rays left at least an electron."""
    struck = np.zeros(hits.shape, np.bool_)
    counts = hits.charge_e >= 1.0
    struck[hits.row[counts], hits.column[counts]] = True
    return struck


_J2000 = datetime(2000, 1, 1, 12)
_MJD_J2000, _YEAR_DAYS, _DAY_S = 51544.5, 365.25, 86400.0


# --- Cards of the header: time, instrument, attitude, rate, light, world coordinates


def header_cards(scene: Scene, made: MadeFrame) -> list[Card]:
    """Cards (keyword, value, comment) for ``write_frame(..., cards=...)``; nothing of the machine or its clock."""
    config, attitude = scene.config, made.plan.attitude
    ra, dec, roll = angles_from_attitude(attitude)
    quaternion = zip("XYZW", quat_xyzw(attitude).tolist(), strict=True)
    rate = zip("XYZ", (made.plan.rate_rad_per_s * RAD_DEG).tolist(), strict=True)
    days = (config.catalogue.epoch_year - 2000.0) * _YEAR_DAYS + _since_epoch_s(scene, made) / _DAY_S
    return [
        ("TIMESYS", "TDB", "time scale of the dates"),
        ("DATE-OBS", (_J2000 + timedelta(days=days)).isoformat(timespec="milliseconds"), "start of the exposure"),
        ("MJD-OBS", _MJD_J2000 + days, "[d] start of the exposure"),
        *instrument_cards(scene.instrument),
        ("SEED", config.seed, "seed of the dataset"),
        ("SPLIT", made.plan.split, "part of the dataset"),
        ("RA_BORE", ra, "[deg] boresight, middle of the exposure"),
        ("DEC_BORE", dec, "[deg] boresight, middle of the exposure"),
        ("ROLL", roll, "[deg] position angle of up (smaller rows)"),
        *((f"QUAT_{axis}", value, "attitude cam from icrs, scalar last") for axis, value in quaternion),
        *((f"RATE_{axis}", value, "[deg/s] angular velocity in cam") for axis, value in rate),
        ("JYEAR", config.catalogue.epoch_year, "[yr] Julian year of the exposure"),
        ("OBSERVER", config.catalogue.observer, "earth: with parallax and aberration"),
        ("MAGLIMIT", scene.faintest_mag, "[mag] faintest stars rendered"),
        ("SKYLIGHT", made.background_e, "[e-] mean expected sky light per pixel"),
        *scene.wcs.header(attitude.as_matrix()),
    ]


def _since_epoch_s(scene: Scene, made: MadeFrame) -> float:
    """Start of an exposure after the epoch: frames of a scan follow each other, the middle of any other is at it."""
    path = scene.plan.path
    return made.plan.start_s - path.start_s if path is not None else -0.5 * scene.plan.duration_s


def instrument_cards(instrument: Instrument) -> list[Card]:
    """What made the image."""
    camera, chip, config = instrument.camera, instrument.detector, instrument.config
    pitch_um = 1e3 * camera.pixel_pitch_mm
    return [
        ("INSTRUME", _ascii(f"{camera.lens.name} + {chip.name}"), "lens and detector"),
        ("LENS", _ascii(camera.lens.name), "lens prescription"),
        ("DETECTOR", _ascii(chip.name), "detector description"),
        ("FOCALLEN", instrument.focal_length_mm, "[mm] scale of the image, design wavelength"),
        ("XPIXSZ", pitch_um, "[um] pixel pitch along columns"),
        ("YPIXSZ", pitch_um, "[um] pixel pitch along rows"),
        ("CCD-TEMP", config.chip_temperature_c, "[C] temperature of the chip"),
        ("SATURATE", _saturation_dn(instrument), "[DN] full well or end of the converter"),
        ("CREATOR", _creator(), "program"),
    ]


def _saturation_dn(instrument: Instrument) -> int:
    chip = instrument.detector
    curve = 1.0 + sum(chip.nonlinearity)  # at the full well
    return min(chip.largest_dn, int(chip.offset_dn + chip.gain_dn_per_e * chip.full_well_e * curve))


@lru_cache(maxsize=1)
def _creator() -> str:
    try:
        return f"starbench {metadata.version('starbench')}"
    except metadata.PackageNotFoundError:
        return "starbench"


def _ascii(text: str) -> str:
    """Header text: printable ASCII, short enough for a card."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)[:60]
