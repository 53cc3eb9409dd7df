"""From sky, star sensor and pointing to a frame: light by source with its truth, read-out, and both together.

`SkySimulator.expected` gives what falls on the detector (`SkyLight`), `SkySimulator.read` the digital numbers of one
read-out of it, `SkySimulator.observe` both. Light may be read out many times; noise depends on the number and label of
the read-out alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.lens.heated_lens import Housing, ThermalState, heated_lens
from optics.light.band import Band
from optics.light.pst import PointSourceTransmittance
from optics.rays.paraxial import axial_paraxial
from render.bodies.ghost_sources import GhostSources
from render.bodies.solar_system import SolarSystem, hiding_spheres, joined, planet_field, solar_system
from render.bodies.stray_light import StrayLight, band_light
from render.camera import FAR_NOISE, Camera, build_camera
from render.catalogue.temperature import TYPICAL_TEMPERATURE_K
from render.detector.cosmic_rays import CosmicRayEnvironment, CosmicRayHits, cosmic_ray_hits
from render.detector.maps import dark_electrons
from render.detector.readout import expose, mean_dark_frame
from render.engine.random import Streams
from render.forward import StarRenderer
from render.motion.trajectory import ConstantRate, Trajectory
from render.observation import BodyDisk, Observation, SkyLight
from render.records import Frame, StarField, Truth, checked_exposure
from render.sensor import StarSensor
from render.sky.background import BackgroundMap, UniformSky, background_map, sky_background
from render.sky.field import FieldOfView, SkyField, field_of_view
from render.sky.sky import Sky, load_sky
from render.sky.star_light import star_light
from render.tracing.convergence import MOTION_TOLERANCE, TOLERANCE
from render.tracing.ghosts import DETECTOR_REFLECTANCE, Ghosting, GhostLight, GhostTruth
from render.tracing.motion.exposure import ExposureMotion, exposure_motion
from render.tracing.waves.diffraction_spikes import BEYOND

if TYPE_CHECKING:
    from render.bodies.body_image import BodyRenderer

NODES = 6
MARGIN_PX = 16.0
"""Distance from the detector within which stars are rendered too: their spots reach onto it."""
WING_LAMBDA_N = 2.0 / (math.pi**2 * BEYOND)
"""Radius [lambda N] beyond which an Airy pattern has the part `BEYOND` of its light, the wings of a saturated planet:
1 - EE(r) = 2 / (pi^2 r) (Born and Wolf, Principles of Optics, sec. 8.5.2)."""


class SkySimulator:
    """Renders frames of the sky by a star sensor at many attitudes.

    Parameters
    ----------
    sensor : StarSensor
        Camera and detector (`render.load_star_sensor`).
    sky : Sky, optional
        The stars; the built-in sky to G = 8 if left out.
    exposure_s : float, optional
        Exposure time; the sensor's if left out.
    line_time_s : float
        Rolling shutter: how much later than its neighbour the next row starts; 0 for a global shutter.
    passband : Band, optional
        Filter in front of the camera (`StarSensor.passband`); the sensor's if left out, or the whole range of lens and
        detector.
    nodes : int
        Wavelengths at which it is sampled.
    throughput_fraction : float
        Part of all light that the rest of the optics (dust, ageing) lets through.
    temperature_c : float, optional
        Temperature of the detector; the sensor's if left out, or the reference temperature of the detector.
    background_e_per_s : float
        Uniform background [e-/s] in every pixel.
    zodiacal : bool
        Whether there is zodiacal light, as seen from the Earth or the observer of the sky.
    uniform : UniformSky or float, optional
        Other light of the sky; a number: V magnitude per square arcsecond, of sunlight.
    seed : int or Streams
        Of the noise.
    bodies : sequence of str, or SolarSystem
        Which of Moon, Earth and planets are there (`render.bodies.solar_system.BODIES`, ``"earth"``), as the observer
        of the sky sees them: the Earth needs one above it (`Observer.moved`). Those larger than a pixel are disks that
        hide stars and one another, the others points of light, left out where no magnitude is published.
    disks_above_px : float
        Diameter above which a body is a disk; infinite: all are points.
    stray_light : path or PointSourceTransmittance, optional
        Table of the camera (``pst.ecsv`` of experiment ``straylight``): Sun and Moon, and the Earth where ``bodies``
        has it, as the observer of the sky sees them, add even light to every pixel; their images are not drawn.
    ghosts : bool or GhostLight
        Whether ghosts are rendered: those whose brightest pixel holds a quarter of the read noise, or what a record
        says; of stars inside and outside the frame, of Moon and planets in ``bodies``, and of Sun and Moon with a table
        ``stray_light`` that has the cause ``ghosts``: its mean of them, where they fall; the rest of the table is even
        light.
    detector_reflectance : float
        Of light that the detector returns to the lens, for ghosts.
    cosmic_rays : str or CosmicRayEnvironment, optional
        Particles that strike the detector (`render.detector.cosmic_rays.list_environments`).
    silicon_depth_um : float
        Thickness of the silicon that they cross.
    housing : Housing, optional
        Holds the lens; needed for its temperature states.
    margin_px : float, optional
        Strip around the detector whose stars are rendered too; 16 px, and as far as stars move in, if left out.
    tolerance : float, optional
        Largest error of a pixel by the quadratures of pupil and motion, relative to the star's light; 3e-5 and 1e-4 if
        left out.
    by_grid : bool
        As in `StarRenderer`.
    sobol_log2_rays : int
        As in `StarRenderer`.

    Attributes
    ----------
    light : StarLight
        The pass band: light of stars of any magnitude and temperature (``light.stars(direction, ...)``).
    view : FieldOfView
        What the camera sees.
    disks : SolarSystem or None
        Bodies larger than a pixel.

    Raises
    ------
    StarbenchError
        A detector that sees beyond the lens's field, a pass band beyond what is known, exposure not positive, an engine
        that is missing; bodies for a sky without observer, an observer inside one.

    Examples
    --------
    >>> simulator = SkySimulator(sensor, exposure_s=0.2)  # doctest: +SKIP
    >>> observations = [simulator.observe(attitude, frame=k) for k, attitude in enumerate(attitudes)]  # doctest: +SKIP
    """

    def __init__(
        self,
        sensor: StarSensor,
        sky: Sky | None = None,
        *,
        exposure_s: float | None = None,
        line_time_s: float = 0.0,
        passband: Band | None = None,
        nodes: int = NODES,
        throughput_fraction: float = 1.0,
        temperature_c: float | None = None,
        background_e_per_s: float = 0.0,
        zodiacal: bool = False,
        uniform: UniformSky | float | None = None,
        seed: int | Streams = 0,
        bodies: Sequence[str] | SolarSystem = (),
        disks_above_px: float = 1.0,
        stray_light: str | Path | PointSourceTransmittance | None = None,
        ghosts: bool | GhostLight = False,
        detector_reflectance: float = DETECTOR_REFLECTANCE,
        cosmic_rays: str | CosmicRayEnvironment | None = None,
        silicon_depth_um: float = 10.0,
        housing: Housing | None = None,
        margin_px: float | None = None,
        tolerance: float | None = None,
        by_grid: bool = False,
        sobol_log2_rays: int = 16,
    ) -> None:
        sensor.check_field()
        self.sensor, self._sky, self.housing = sensor, sky, housing
        self.exposure_s = checked_exposure(sensor.exposure_s if exposure_s is None else exposure_s)
        self.line_time_s = line_time_s
        self.throughput_fraction = throughput_fraction
        self.temperature_c = sensor.temperature_c if temperature_c is None else temperature_c
        self.background_e_per_s = background_e_per_s
        self._streams = seed if isinstance(seed, Streams) else Streams(seed)
        self._cosmic_rays, self._silicon_depth_um = cosmic_rays, silicon_depth_um
        self.band = passband or sensor.band or sensor.passband()
        system = "G" if sky is None else sky.catalog.magnitude_system
        self.light = star_light([self.band], nodes=nodes, magnitude_system=system)
        self._margin_px = margin_px
        self.view = field_of_view(sensor.camera, margin_px=MARGIN_PX if margin_px is None else margin_px)
        self.diffuse: BackgroundMap | None = None
        self.zodiacal = zodiacal
        self.uniform = UniformSky(magnitude_per_arcsec2=uniform) if isinstance(uniform, float | int) else uniform
        if zodiacal or uniform is not None:
            self.diffuse = background_map(sensor.camera, [self.band])
        self._body_names = bodies.name if isinstance(bodies, SolarSystem) else tuple(bodies)
        self._stray: StrayLight | None = None
        if stray_light is not None:
            self._stray = StrayLight(
                stray_light,
                band_light(sensor.detector, self.band),
                observer=self.sky.observer,
                epoch_year=self.sky.epoch_year,
                earth="earth" in self._body_names,
                ghosts=bool(ghosts),
            )
        self.disks: SolarSystem | None = None
        self._points: tuple[SolarSystem, StarField] | None = None
        if len(bodies):
            system_bodies = self._solar_system(bodies)
            large = system_bodies.angular_diameter_rad > disks_above_px * np.radians(sensor.pixel_arcsec / 3600.0)
            points = system_bodies.select(~large & np.isfinite(system_bodies.magnitude_v))
            self.disks, self._points = (
                system_bodies.select(large),
                (points, planet_field(points, [self.band], nodes=nodes)),
            )
        self._planet_margin_px = max(self.view.margin_px, _wing_px(sensor.camera))
        self._motion_tolerance = MOTION_TOLERANCE if tolerance is None else tolerance
        self._rendering: dict[str, Any] = {
            "exposure_s": self.exposure_s,
            "tolerance": TOLERANCE if tolerance is None else tolerance,
            "by_grid": by_grid,
            "sobol_log2_rays": sobol_log2_rays,
            "contents": None if self.disks is None else hiding_spheres(self.disks),
        }
        self._renderers: dict[bytes, StarRenderer] = {}
        self._ghosts, self._detector_reflectance = ghosts, detector_reflectance
        self._hits: dict[tuple[int, str | None, Streams], CosmicRayHits] = {}
        self._disks_at_rest: tuple[bytes, tuple[BodyDisk, ...]] = b"", ()  # of an attitude that may come again

    @property
    def sky(self) -> Sky:
        """The stars; the built-in sky is loaded when it is first needed."""
        if self._sky is None:
            self._sky = load_sky()
        return self._sky

    def _solar_system(self, bodies: Sequence[str] | SolarSystem) -> SolarSystem:
        if isinstance(bodies, SolarSystem):
            return bodies
        if self.sky.observer is None:
            raise ConfigError(f"bodies = {', '.join(bodies)}: the sky needs an observer, load_sky(observer='earth')")
        return solar_system(self.sky.epoch_year, observer=self.sky.observer, bodies=bodies)

    @cached_property
    def _body_renderer(self) -> BodyRenderer:
        from render.bodies.body_image import BodyRenderer

        return BodyRenderer(self.sensor.camera, [self.band], view=self.view)

    @cached_property
    def _ghost_sources(self) -> GhostSources | None:
        """All that may make ghosts; None where none are rendered."""
        if not self._ghosts:
            return None
        sky, least_e = self.sky, FAR_NOISE * max(self.sensor.detector.read_noise_e, 1.0)
        faint = GhostLight(least_e=least_e, detector_reflectance=self._detector_reflectance)
        return GhostSources(
            Ghosting(self.sensor.camera, self._ghosts if isinstance(self._ghosts, GhostLight) else faint),
            self.light.stars(sky.direction, sky.magnitude, sky.temperature_k),
            sky.id,
            exposure_s=self.exposure_s * self.throughput_fraction,
            bands=[self.band],
            observer=sky.observer,
            epoch_year=sky.epoch_year,
            bodies=self._body_names,
            stray=self._stray,
        )

    @cached_property
    def axial_transmission(self) -> float:
        """Part of the light of a star on the axis, within the stop, that the other apertures let through."""
        star = self.light.stars(np.array([[0.0, 0.0, 1.0]]), 0.0, TYPICAL_TEMPERATURE_K)
        truth = StarRenderer(self.sensor.camera, tolerance=self._rendering["tolerance"]).trace(star).truth
        return float(1.0 - truth.electrons_vignetted[0, 0] / truth.electrons_in[0, 0])

    def expected(
        self,
        attitude: Rotation | Trajectory,
        *,
        rate_deg_per_s: ArrayLike | None = None,
        start_s: float | None = None,
        stars: StarField | None = None,
        velocity_km_per_s: ArrayLike | None = None,
        lens_state: ThermalState | None = None,
        label: str = "",
    ) -> SkyLight:
        """Light of one exposure.

        Parameters
        ----------
        attitude : Rotation or Trajectory
            cam from icrs (`optics.attitude_from_angles`), the same for the whole exposure; or how the camera moves
            (`render.motion.trajectory`, body axes those of cam). Diffuse light and point-like planets are those of the
            middle of the exposure.
        rate_deg_per_s : (3,), optional
            Angular velocity in cam axes, through an attitude in the middle of the exposure.
        start_s : float, optional
            When the exposure begins on a trajectory [s]; at its start if left out.
        stars : StarField, optional
            Take the place of the sky's stars: artificial ones, or stars whose light varies (``simulator.light.stars``).
            Their world is that of the attitude; with ``Rotation.identity()`` directions are in cam.
        velocity_km_per_s : (3,), optional
            Velocity of the camera along icrs in this exposure: aberration of the sky's stars, in place of that by the
            sky's observer. Bodies stay where that observer sees them.
        lens_state : ThermalState, optional
            Temperature field of the lens; a renderer is kept for each. Diffuse light, ghosts and disks are those of
            the lens at rest.
        label : str
            Name of the scene file (`render.forward.SCENES`).

        Raises
        ------
        ConfigError
            Not a single rotation; a rate with a trajectory; a lens state without `housing`.
        DomainError
            The Sun within 15 deg of a pixel, with zodiacal light; a trajectory that ends before the exposure; a
            temperature beyond that of the glasses.
        """
        middle, path, begin = self._pointing(attitude, rate_deg_per_s, start_s)
        motion = None if path is None else self._motion(path, begin)
        field = planets = None
        if stars is None:
            field = self.sky.field(self._view_of(motion), middle, velocity_km_per_s=velocity_km_per_s)
            stars = self.sky.star_field(field, self.light)
        count = len(stars)
        if self._points is not None:
            planets, stars = self._with_planets(stars, middle)
        if self.throughput_fraction != 1.0:
            stars = replace(stars, photon_rate=stars.photon_rate * self.throughput_fraction)
        renderer = self._renderer(lens_state)
        renderer.label = label
        pose = {"rotation_cam_from_world": middle.as_matrix()} if motion is None else {"motion": motion}
        traced = renderer.trace(stars, **pose)
        layers = {name: image[:, :, 0] for name, image in traced.layers().items()}
        ghosts: GhostTruth | None = None
        sources_outside: tuple[str, ...] = ()
        if self._ghost_sources is not None:
            layers["ghosts"], ghosts, sources_outside = self._ghost_light(stars, traced.truth, count, field, middle)
        layers |= self._diffuse_light(middle)
        disks = self._visible_disks(middle, path, begin)
        if self.disks is not None:
            layers["bodies"] = np.zeros(self.sensor.detector.shape, np.float32)
            for disk in disks:
                layers["bodies"] += disk.image.image.electrons[:, :, 0]
        return SkyLight(
            electrons=reduce(np.add, layers.values()),
            layers=layers,
            sources=stars,
            truth=traced.truth,
            field=field,
            planets=planets,
            disks=disks,
            ghosts=ghosts,
            sources_outside=sources_outside,
            attitude=middle,
            band=stars.band[0],
            exposure_s=self.exposure_s,
        )

    def read(
        self,
        light: SkyLight | NDArray[Any],
        *,
        frame: int = 0,
        label: str | None = None,
        added_e: ArrayLike | None = None,
        background_e_per_s: float | None = None,
        before: SkyLight | None = None,
        streams: Streams | None = None,
    ) -> Frame:
        """Read light out once.

        Parameters
        ----------
        light : SkyLight or (h, w)
            Expected electrons of the exposure.
        frame : int
            Number of the read-out: another number, other noise.
        label : str, optional
            Name of the read-out (`Frame.band`) and of its noise; that of the pass band if left out.
        added_e : float or (h, w), optional
            More light in this frame [e-].
        background_e_per_s : float, optional
            Uniform background [e-/s] in place of the simulator's.
        before : SkyLight, optional
            Light of frame ``frame - 1``, of which a detector with lag holds a part.
        streams : Streams, optional
            Root of the noise in place of the simulator's.

        Raises
        ------
        DomainError
            As `render.detector.readout.expose`.
        """
        electrons, band = (light.electrons, light.band) if isinstance(light, SkyLight) else (light, "")
        charge_before = None
        if before is not None and self.sensor.detector.lag > 0.0:
            charge_before = before.electrons.copy()
            if (hits := self.hits(frame - 1, label, streams)) is not None:
                np.add.at(charge_before, (hits.row, hits.column), hits.charge_e.astype(np.float32))
        return expose(
            electrons if added_e is None else electrons + np.asarray(added_e),
            self.sensor.detector,
            streams=self._streams if streams is None else streams,
            frame=frame,
            exposure_s=self.exposure_s,
            temperature_c=self.temperature_c,
            background_e_per_s=self.background_e_per_s if background_e_per_s is None else background_e_per_s,
            band=band if label is None else label,
            hits=self.hits(frame, label, streams),
            before=charge_before,
        )

    def hits(self, frame: int = 0, label: str | None = None, streams: Streams | None = None) -> CosmicRayHits | None:
        """Charge of the cosmic rays in a read-out; None without them. Parameters as in `read`."""
        if self._cosmic_rays is None:
            return None
        root = self._streams if streams is None else streams
        key = frame, label, root
        if key not in self._hits:
            while len(self._hits) > 1:  # this frame's and the one's before
                self._hits.pop(next(iter(self._hits)))
            self._hits[key] = cosmic_ray_hits(
                self.sensor.detector,
                self._cosmic_rays,
                streams=root if label is None else root.child(label),
                frame=frame,
                exposure_s=self.exposure_s,
                depth_um=self._silicon_depth_um,
            )
        return self._hits[key]

    def observe(
        self,
        attitude: Rotation | Trajectory,
        *,
        frame: int = 0,
        layers: bool = False,
        before: SkyLight | None = None,
        **exposure: Any,
    ) -> Observation:
        """Expose one frame: `expected` and `read`.

        Parameters
        ----------
        attitude : Rotation or Trajectory
            As in `expected`.
        frame : int
            Number of the frame: another number, other noise.
        layers : bool
            Whether the light of every source is also returned separately (`Observation.layers`).
        before : SkyLight, optional
            Light of the frame before (`Observation.light`), for a detector with lag.
        **exposure
            Any other parameter of `expected`: ``rate_deg_per_s=``, ``start_s=``, ``velocity_km_per_s=`` ...
        """
        light = self.expected(attitude, **exposure)
        return Observation(
            frame=self.read(light, frame=frame, before=before),
            light=light,
            sensor=self.sensor,
            sky=self.sky,
            layers=light.layers | {"dark": self.dark_electrons()} if layers else None,
        )

    def stray_e_per_s(self, attitude: Rotation) -> dict[str, float]:
        """Stray light of each body in an attitude [e- s^-1 per pixel]; empty without a table."""
        return {} if self._stray is None else self._stray.uniform(attitude)

    def dark_electrons(self) -> NDArray[np.float32]:
        """Electrons (h, w) that the detector adds to the light: dark current of every pixel, and background."""
        return dark_electrons(
            self.sensor.detector,
            self.exposure_s,
            temperature_c=self.temperature_c,
            background_e_per_s=self.background_e_per_s,
        )

    def dark_dn(self, *, frames: int = 20) -> NDArray[np.float32]:
        """Mean (h, w) [DN] of dark frames with the exposure of the others: a master dark.

        `calib.subtract_dark` takes the fixed pattern and the dark current out of a frame with it.
        """
        return mean_dark_frame(
            self.sensor.detector,
            frames,
            streams=self._streams.child("dark"),
            exposure_s=self.exposure_s,
            temperature_c=self.temperature_c,
            band="dark",
        )

    def pixel_px(self, v_cam: FloatArray) -> FloatArray:
        """Column and row (n, 2) of directions (n, 3) in cam in front of the camera; undistorted beyond the field."""
        camera = self.sensor.camera
        scale = self.sensor.focal_length_mm / camera.pixel_pitch_mm
        traced = self.view.pixel_of(v_cam)
        return np.where(np.isfinite(traced), traced, v_cam[:, :2] / v_cam[:, 2:] * scale + camera.centre_px)

    def smear_px(
        self, path: Trajectory, direction: FloatArray, row_px: FloatArray, *, start_s: float | None = None
    ) -> FloatArray:
        """Motion (n, 2) of chief rays at the design wavelength from the start to the end of their row's exposure [px].

        ``direction`` (n, 3) along icrs, ``row_px`` (n,) the rows on which they land; other parameters as in `expected`.
        """
        begin_s = path.start_s if start_s is None else start_s
        rows = np.clip(np.nan_to_num(row_px), 0.0, self.sensor.camera.height_px - 1.0)
        first_s = begin_s + rows * self.line_time_s
        ends = [
            self.view.pixel_of(path.attitude(times).apply(direction)) for times in (first_s, first_s + self.exposure_s)
        ]
        return np.asarray(ends[1] - ends[0])

    # --- Pointing, lens and light of one exposure

    @property
    def _duration_s(self) -> float:
        """From the start of the exposure of the first row to the end of that of the last."""
        return self.exposure_s + max(0, self.sensor.camera.height_px - 1) * self.line_time_s

    def _pointing(
        self, attitude: Rotation | Trajectory, rate_deg_per_s: ArrayLike | None, start_s: float | None
    ) -> tuple[Rotation, Trajectory | None, float]:
        """Attitude of the middle of the exposure, the motion where there is one, and when it begins on it."""
        if isinstance(attitude, Rotation):
            if not attitude.single or start_s is not None:
                raise ConfigError("attitude must be one scipy Rotation, cam from icrs; start_s is for a trajectory")
            if rate_deg_per_s is None:
                return attitude, None, 0.0
            turn = np.radians(np.asarray(rate_deg_per_s, float))
            if turn.shape != (3,) or not np.isfinite(turn).all():
                raise ConfigError(f"rate_deg_per_s = {rate_deg_per_s}: three finite numbers are needed, about x, y, z")
            first = Rotation.from_rotvec(0.5 * self._duration_s * turn) * attitude
            return attitude, ConstantRate(initial=first, rate_rad_per_s=turn, end_s=self._duration_s), 0.0
        if not hasattr(attitude, "attitude") or rate_deg_per_s is not None:
            raise ConfigError(
                "attitude must be one scipy Rotation, cam from icrs (optics.attitude_from_angles makes it), with a "
                "rate_deg_per_s or without, or a trajectory, which has its own rate"
            )
        begin = attitude.start_s if start_s is None else start_s
        return attitude.attitude(begin + 0.5 * self._duration_s), attitude, begin

    def _motion(self, path: Trajectory, begin_s: float) -> ExposureMotion:
        return exposure_motion(
            path,
            start_s=begin_s,
            exposure_s=self.exposure_s,
            camera=self.sensor.camera,
            line_time_s=self.line_time_s,
            tolerance=self._motion_tolerance,
        )

    def _view_of(self, motion: ExposureMotion | None) -> FieldOfView:
        """The field of view, wider where stars come in during an exposure."""
        out_px = 0.0 if motion is None else 0.5 * motion.length_px
        if self._margin_px is not None or out_px < 0.25 * MARGIN_PX:
            return self.view
        return field_of_view(self.sensor.camera, margin_px=MARGIN_PX + out_px)

    def _renderer(self, state: ThermalState | None) -> StarRenderer:
        """Renderer of the lens in a temperature state."""
        key = b"" if state is None or not state.vector.any() else state.vector.tobytes()
        if key not in self._renderers:
            camera = self.sensor.camera
            if state is not None and key:
                if self.housing is None:
                    raise ConfigError("lens_state: SkySimulator(..., housing=Housing(expansion_per_k=...)) is needed")
                camera = _with_lens(self.sensor, heated_lens(camera.lens, state, self.housing))
            self._renderers[key] = StarRenderer(camera, **self._rendering)
        return self._renderers[key]

    def _with_planets(self, stars: StarField, attitude: Rotation) -> tuple[SolarSystem, StarField]:
        """Point-like planets whose wings reach the detector, and the sources with them."""
        assert self._points is not None
        system, light = self._points
        v_cam = system.direction @ attitude.as_matrix().T
        rows = np.flatnonzero(v_cam[:, 2] > 0.0)
        rows = rows[self.view.on_detector(self.pixel_px(v_cam[rows]), self._planet_margin_px)]
        return system.select(rows), joined(stars, light.select(rows))

    def _ghost_light(
        self, sources: StarField, truth: Truth, count: int, field: SkyField | None, attitude: Rotation
    ) -> tuple[NDArray[np.float32], GhostTruth, tuple[str, ...]]:
        """Ghosts of ``count`` stars in the frame and, for those of a sky, of all that is outside."""
        assert self._ghost_sources is not None
        image = np.zeros((*self.sensor.detector.shape, 1), np.float32)
        stars = sources.select(slice(count))
        star_truth = truth.select(slice(count))
        if field is None:
            v = stars.direction @ attitude.as_matrix().T
            return image[:, :, 0], self._ghost_sources.ghosting.add(image, v, stars.wavelength_nm, star_truth), ()
        ghosts, sources_outside = self._ghost_sources.add(image, attitude, stars, field.stars.id, star_truth)
        return image[:, :, 0], ghosts, sources_outside

    def _diffuse_light(self, attitude: Rotation) -> dict[str, NDArray[np.float32]]:
        """Light of the sky and stray light [e-]; uniform light of ``background_e_per_s`` is not part of it."""
        light, seconds = dict[str, NDArray[np.float32]](), np.float32(self.exposure_s * self.throughput_fraction)
        if self.diffuse is not None:
            rate = sky_background(
                self.diffuse,
                attitude,
                epoch_year=self.sky.epoch_year,
                observer=self.sky.observer,
                zodiacal=self.zodiacal,
                uniform=self.uniform,
            )
            light["sky"] = rate[:, :, 0] * seconds
        if stray := self.stray_e_per_s(attitude):
            light["stray"] = np.full(self.sensor.detector.shape, sum(stray.values()) * seconds, np.float32)
        return light

    def _visible_disks(self, attitude: Rotation, path: Trajectory | None, begin_s: float) -> tuple[BodyDisk, ...]:
        """Bodies larger than a pixel, with their light, the nearest first."""
        if self.disks is None or not len(self.disks):
            return ()
        key = attitude.as_quat().tobytes() if path is None else b""
        if key and self._disks_at_rest[0] == key:
            return self._disks_at_rest[1]
        rate = np.zeros(3) if path is None else path.rate(begin_s + 0.5 * self._duration_s)
        images = self._body_renderer.render_system(
            self.disks,
            attitude.as_matrix(),
            turn_rad=float(np.linalg.norm(rate)) * self._duration_s,
            exposure_s=self.exposure_s,
            trajectory=path,
            start_s=begin_s,
            line_time_s=self.line_time_s,
            ceiling_e=self.sensor.detector.full_well_e,
        )
        part = self.throughput_fraction
        disks = tuple(
            BodyDisk(name=self.disks.name[row], row=row, image=image if part == 1.0 else image.dimmed(part))
            for row, image in images
        )
        self._disks_at_rest = key, disks
        return disks


def _wing_px(camera: Camera) -> float:
    """Radius [px] of the diffraction image of a saturated star."""
    if camera.far is None or camera.diffraction == "rays":
        return 0.0
    f_number = axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).f_number
    return WING_LAMBDA_N * camera.lens.design_wavelength_nm * 1e-6 * f_number / camera.pixel_pitch_mm


def _with_lens(sensor: StarSensor, lens: Any) -> Camera:
    """The camera of a sensor with another lens on the same axis, and its transmission."""
    camera, losses = sensor.camera, sensor.camera.losses
    if losses is None:
        return replace(camera, lens=lens)
    built = build_camera(lens, sensor.detector, coating=losses.coating, absorption=losses.absorption)
    return replace(camera, lens=lens, response=built.response)


def observe(
    sensor: StarSensor,
    attitude: Rotation | Trajectory,
    sky: Sky | None = None,
    *,
    exposure_s: float | None = None,
    seed: int = 0,
    rate_deg_per_s: ArrayLike | None = None,
    velocity_km_per_s: ArrayLike | None = None,
    lens_state: ThermalState | None = None,
    layers: bool = False,
    **settings: Any,
) -> Observation:
    """Render a frame of the sky; for many frames use `SkySimulator`.

    Parameters
    ----------
    sensor : StarSensor
        Camera and detector (`load_star_sensor`).
    attitude : Rotation or Trajectory
        cam from icrs (`optics.attitude_from_angles`), or how the camera moves, from its start on.
    sky : Sky, optional
        The stars (`load_sky`); the built-in sky to G = 8 if left out.
    exposure_s : float, optional
        Exposure time; the sensor's if left out.
    seed : int
        Of the noise.
    rate_deg_per_s : (3,), optional
        Angular velocity in cam axes.
    velocity_km_per_s : (3,), optional
        Velocity of the camera along icrs, in place of that of the sky's observer.
    lens_state : ThermalState, optional
        Temperature field of the lens; needs ``housing=``.
    layers : bool
        Whether the light of every source is also returned separately.
    **settings
        Any other setting of `SkySimulator`: ``passband=``, ``temperature_c=``, ``zodiacal=``, ``bodies=``,
        ``cosmic_rays=`` ...

    Returns
    -------
    Observation
        Frame, truth, sky and stars of the field.

    Raises
    ------
    StarbenchError
        As `SkySimulator`.
    """
    simulator = SkySimulator(sensor, sky, exposure_s=exposure_s, seed=seed, **settings)
    return simulator.observe(
        attitude,
        rate_deg_per_s=rate_deg_per_s,
        velocity_km_per_s=velocity_km_per_s,
        lens_state=lens_state,
        layers=layers,
    )
