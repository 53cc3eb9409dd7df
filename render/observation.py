"""From a star sensor and an attitude to a frame of the real sky: stars, lens, diffuse light, detector."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.attitude import angles_from_attitude
from optics.errors import ConfigError
from optics.light.band import Band
from optics.light.pst import PointSourceTransmittance
from optics.page import Marks, differences, save_frame_page
from render.bodies.ghost_sources import GhostSources
from render.bodies.solar_system import SolarSystem, hiding_spheres, planet_field, solar_system
from render.bodies.stray_light import StrayLight, band_light
from render.camera import FAR_NOISE
from render.detector.maps import dark_electrons
from render.detector.readout import expose
from render.engine.random import Streams
from render.fits.wcs import lens_wcs, sky_grid
from render.forward import StarRenderer
from render.motion.trajectory import ConstantRate, Trajectory
from render.records import ExpectedImage, Frame, Truth
from render.sensor import StarSensor
from render.sky.background import BackgroundMap, UniformSky, background_map, sky_background
from render.sky.field import FieldOfView, SkyField, field_of_view
from render.sky.sky import Sky, load_sky
from render.sky.star_light import star_light
from render.tracing.ghosts import Ghosting, GhostLight, GhostTruth
from render.tracing.motion.exposure import ExposureMotion, exposure_motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NODES = 6
MARGIN_PX = 16.0
"""Distance from the detector within which stars are rendered too: their spots reach onto it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Observation:
    """A frame of the sky with its truth, attitude and settings.

    Attributes
    ----------
    frame : Frame
        What the detector gave out.
    expected : ExpectedImage
        Expected electrons of the frame, diffuse light included, with the truth of every star.
    field : SkyField
        The stars of the truth, in the same order: catalogue rows, directions.
    attitude : Rotation
        cam from icrs.
    sensor : StarSensor
        Camera and detector.
    sky : Sky
        All stars of the sky, as known to a star identifier.
    bodies : dict of str to (float, float, float)
        Column and row [px] of the centroid, and electrons, of each of the simulator's bodies in the frame.
    ghosts : GhostTruth or None
        Ghosts in the frame, where the simulator renders them: their stars count in ``field``, from ``len(field)`` on
        in ``beside``.
    beside : tuple of str
        Sources of ghosts outside the field: ids of bright stars anywhere in front of the lens, bodies.
    layers : dict of str to (h, w) float32, or None
        Expected electrons by source, if requested: ``stars``, ``scatter`` (their halos), ``ghosts``, ``sky`` (zodiacal
        and other light), ``stray`` (Sun, Moon, Earth outside the field) and ``bodies`` add up to ``expected``. ``dark``
        is the detector's contribution: dark current of every pixel and ``background_e_per_s``.
    """

    frame: Frame
    expected: ExpectedImage
    field: SkyField
    attitude: Rotation
    sensor: StarSensor
    sky: Sky
    bodies: dict[str, tuple[float, float, float]]
    ghosts: GhostTruth | None = None
    beside: tuple[str, ...] = ()
    layers: dict[str, NDArray[np.float32]] | None = None

    def __repr__(self) -> str:
        ra, dec, roll = angles_from_attitude(self.attitude)
        height, width = self.frame.dn.shape
        return (
            f"<Observation at ra {ra:.4f}, dec {dec:.4f}, roll {roll:.4f} deg: {width} x {height} px, "
            f"{self.frame.exposure_s:g} s, {len(self.field)} stars>"
        )

    @property
    def truth(self) -> Truth:
        """True positions and light balance of every star."""
        assert self.expected.truth is not None
        return self.expected.truth

    def to_table(self) -> Any:
        """Truth as an `astropy.table.Table`: a row per star with identity, position and electrons."""
        from astropy import units
        from astropy.table import Table

        stars, table = self.field.stars, Table()
        x, y, z = self.field.direction.T
        table["star_id"] = np.array(stars.id)
        table["ra"] = np.degrees(np.arctan2(y, x)) % 360.0 * units.deg
        table["dec"] = np.degrees(np.arcsin(z)) * units.deg
        table["magnitude"] = stars.magnitude * units.mag
        table["temperature"] = self.sky.temperature_k[self.field.row] * units.K
        for name in Truth.__dataclass_fields__:
            base, unit = name.rsplit("_", 1) if name.endswith(("_px", "_px2")) else (name, "")
            table[base] = getattr(self.truth, name)[:, 0]
            table[base].unit = {"px": units.pix, "px2": units.pix**2}.get(unit, units.electron)
        return table

    def show(self, axes: Axes | None = None, *, brightest: int = 12) -> Axes:
        """Draw the frame.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where; in a new figure if left out. ``axes.figure.savefig("frame.png")`` keeps it.
        brightest : int
            Number of stars labelled with their magnitude.

        Returns
        -------
        matplotlib.axes.Axes
            In pixels: (column, row), row 0 on top. `calib.mark_stars` draws measured stars into it.
        """
        from optics.figures import draw_image

        axes = draw_image(self.frame.dn, axes)
        truth, magnitude = self.truth, self.field.stars.magnitude
        lit = np.flatnonzero(truth.electrons_image[:, 0] > 0)
        for star in lit[np.argsort(magnitude[lit], kind="stable")][:brightest]:
            axes.annotate(
                f"{magnitude[star]:.1f}",
                (truth.photon_x_px[star, 0], truth.photon_y_px[star, 0]),
                xytext=(6, 5),
                textcoords="offset points",
                color="#f4d35e",
                fontsize=7,
            )
        axes.set_title(f"{self.frame.exposure_s:g} s, {self.frame.band}, {len(lit)} stars", fontsize=9)
        return axes

    def save_page(self, path: str | Path, layers: Sequence[Marks] = ()) -> Path:
        """Write the frame as a zoomable page with its pixel values, the true and the measured stars.

        Parameters
        ----------
        path : path
            File to write: HTML that needs nothing else, neither server nor network.
        layers : sequence of Marks
            More marks, such as ``calib.star_marks(stars, solution)``; errors against the truth of the
            measured ones, flagged ones (crosses) left out, are added as arrows.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        ConfigError
            It cannot be written.

        Examples
        --------
        >>> observation.save_page("orion.html", star_marks(stars, solution))  # doctest: +SKIP
        """
        frame, true = self.frame, self._true_marks()
        measured = [layer for layer in layers if layer.shape not in ("arrow", "cross")]
        known = [replace(layer, shown=layer.shape != "arrow") for layer in layers]  # the truth says more than residuals
        cards = lens_wcs(self.sensor.camera).header(self.attitude.as_matrix())
        ra, dec, roll = angles_from_attitude(self.attitude)
        return save_frame_page(
            path,
            frame.dn,
            [true, *known, *([differences(measured, true)] if measured else [])],
            title=f"{self.sensor.camera.lens.name}, {frame.exposure_s:g} s",
            facts={
                "right ascension": f"{ra:.4f}°",
                "declination": f"{dec:.4f}°".replace("-", "\N{MINUS SIGN}"),
                "roll": f"{roll:.4f}°",
                "filter": frame.band,
            },
            flags={"saturated": frame.saturated, "defective": frame.defect},
            sky=sky_grid(cards, frame.dn.shape),
        )

    def _true_marks(self) -> Marks:
        """Stars whose light reaches the detector, brightest first."""
        truth, stars, electrons = self.truth, self.field.stars, self.truth.electrons_image[:, 0]
        rows = np.flatnonzero(electrons > 0)
        rows = rows[np.argsort(-electrons[rows], kind="stable")]
        x, y, z = self.field.direction[rows].T
        return Marks(
            name="true stars",
            x_px=truth.photon_x_px[rows, 0],
            y_px=truth.photon_y_px[rows, 0],
            label=[f"{magnitude:.1f}" for magnitude in stars.magnitude[rows]],
            columns={
                "star": np.asarray(stars.id)[rows],
                "magnitude": stars.magnitude[rows],
                "temperature [K]": np.rint(self.sky.temperature_k[self.field.row[rows]]),
                "right ascension [deg]": np.degrees(np.arctan2(y, x)) % 360.0,
                "declination [deg]": np.degrees(np.arcsin(z)),
                "light [e-]": electrons[rows],
            },
        )


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
    passband : Band, optional
        Filter in front of the camera (`StarSensor.passband`); the sensor's if left out, or the whole range of lens and
        detector.
    nodes : int
        Wavelengths at which it is sampled.
    temperature_c : float, optional
        Temperature of the detector; the sensor's if left out, or the reference temperature of the detector.
    background_e_per_s : float
        Uniform background [e-/s] in every pixel.
    zodiacal : bool
        Whether there is zodiacal light, as seen from the Earth or the observer of the sky.
    uniform : UniformSky, optional
        Other light of the sky.
    seed : int
        Of the noise.
    bodies : sequence of str
        Which of Moon, Earth and planets are there (`render.bodies.solar_system.BODIES`, ``"earth"``), as the observer
        of the sky sees them: the Earth needs one above it (`Observer.moved`). Those larger than a pixel are disks that
        hide stars and one another, the others points of light, left out where no magnitude is published.
    stray_light : path or PointSourceTransmittance, optional
        Table of the camera (``pst.ecsv`` of experiment ``straylight``): Sun and Moon, and the Earth where ``bodies``
        has it, as the observer of the sky sees them, add even light to every pixel; their images are not drawn.
    ghosts : bool or GhostLight
        Whether ghosts are rendered: those whose brightest pixel holds a quarter of the read noise, with a detector that
        reflects 20 %, or what a record says; of stars inside and outside the frame, of Moon and planets in ``bodies``,
        and of Sun and Moon with a table ``stray_light`` that has the cause ``ghosts``: its mean of them, where they
        fall; the rest of the table is even light.

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
        passband: Band | None = None,
        nodes: int = NODES,
        temperature_c: float | None = None,
        background_e_per_s: float = 0.0,
        zodiacal: bool = False,
        uniform: UniformSky | None = None,
        seed: int = 0,
        bodies: Sequence[str] = (),
        stray_light: str | Path | PointSourceTransmittance | None = None,
        ghosts: bool | GhostLight = False,
    ) -> None:
        sensor.check_field()
        self.sensor, self.sky = sensor, load_sky() if sky is None else sky
        band = passband or sensor.band or sensor.passband()
        system = self.sky.catalog.magnitude_system
        self.light = star_light([band], nodes=nodes, magnitude_system=system)
        self.view = field_of_view(sensor.camera, margin_px=MARGIN_PX)
        self.diffuse: BackgroundMap | None = None
        self.zodiacal, self.uniform = zodiacal, uniform
        if zodiacal or uniform is not None:
            self.diffuse = background_map(sensor.camera, [band])
        self.temperature_c = sensor.temperature_c if temperature_c is None else temperature_c
        self.background_e_per_s = background_e_per_s
        exposure_s = sensor.exposure_s if exposure_s is None else exposure_s
        self.exposure_s, self._streams = exposure_s, Streams(seed)
        self._stray: StrayLight | None = None
        if stray_light is not None:
            self._stray = StrayLight(
                stray_light,
                band_light(sensor.detector, band),
                observer=self.sky.observer,
                epoch_year=self.sky.epoch_year,
                earth="earth" in bodies,
                ghosts=bool(ghosts),
            )
        self._disks: SolarSystem | None = None
        self._points: SolarSystem | None = None
        hidden = None
        if bodies:
            if self.sky.observer is None:
                raise ConfigError(
                    f"bodies = {', '.join(bodies)}: the sky needs an observer, load_sky(observer='earth')"
                )
            from render.bodies.body_image import BodyRenderer

            there = solar_system(self.sky.epoch_year, observer=self.sky.observer, bodies=bodies)
            large = there.angular_diameter_rad > np.radians(sensor.pixel_arcsec / 3600.0)
            self._disks = there.select(large)
            self._points = there.select(~large & np.isfinite(there.magnitude_v))
            self._point_light = planet_field(self._points, [band], nodes=nodes)
            self._bodies = BodyRenderer(sensor.camera, [band], view=self.view)
            hidden = hiding_spheres(self._disks)
        self._renderer = StarRenderer(sensor.camera, exposure_s=exposure_s, contents=hidden)
        self._ghosts = None
        if ghosts:
            faint = GhostLight(least_e=FAR_NOISE * max(sensor.detector.read_noise_e, 1.0))
            self._ghosts = GhostSources(
                Ghosting(sensor.camera, ghosts if isinstance(ghosts, GhostLight) else faint),
                self.light.stars(self.sky.direction, self.sky.magnitude, self.sky.temperature_k),
                self.sky.id,
                exposure_s=exposure_s,
                bands=[band],
                observer=self.sky.observer,
                epoch_year=self.sky.epoch_year,
                bodies=bodies,
                stray=self._stray,
            )

    def observe(
        self,
        attitude: Rotation | Trajectory,
        *,
        frame: int = 0,
        rate_deg_per_s: ArrayLike | None = None,
        start_s: float | None = None,
        layers: bool = False,
    ) -> Observation:
        """Expose one frame.

        Parameters
        ----------
        attitude : Rotation or Trajectory
            cam from icrs (`optics.attitude_from_angles`), the same for the whole exposure; or how the camera moves
            (`render.motion.trajectory`, body axes those of cam). The observation has the
            attitude of the middle of the exposure, which disks, diffuse light and planets are seen from.
        frame : int
            Number of the frame: another number, other noise.
        rate_deg_per_s : (3,), optional
            Angular velocity in cam axes, through an attitude in the middle of the exposure.
        start_s : float, optional
            When the exposure begins on a trajectory [s]; at its start if left out.
        layers : bool
            Whether the light of every source is kept apart, too (`Observation.layers`).

        Raises
        ------
        ConfigError
            Not a single rotation; a rate with a trajectory.
        DomainError
            The Sun within 15 deg of a pixel, with zodiacal light; a trajectory that ends before the exposure.
        """
        attitude, motion = self._motion(attitude, rate_deg_per_s, start_s)
        field = self.sky.field(self._view_of(motion), attitude)
        stars = self.sky.star_field(field, self.light)
        if motion is None:
            expected = self._renderer.render(stars, rotation_cam_from_world=field.rotation_cam_from_icrs)
        else:
            expected = self._renderer.render(stars, motion=motion)
        assert self._renderer.traced is not None
        light = self._renderer.traced.layers()
        ghosts: GhostTruth | None = None
        beside: tuple[str, ...] = ()
        if self._ghosts is not None:
            light["ghosts"] = np.zeros_like(expected.electrons)
            assert expected.truth is not None
            ghosts, beside = self._ghosts.add(light["ghosts"], attitude, stars, field.stars.id, expected.truth)
        if self.diffuse is not None:
            rate = sky_background(
                self.diffuse,
                attitude,
                epoch_year=self.sky.epoch_year,
                observer=self.sky.observer,
                zodiacal=self.zodiacal,
                uniform=self.uniform,
            )
            light["sky"] = rate * np.float32(expected.exposure_s)
        if stray := self.stray_e_per_s(attitude):
            light["stray"] = np.full_like(expected.electrons, sum(stray.values()) * expected.exposure_s)
        bodies: dict[str, tuple[float, float, float]] = {}
        if self._disks is not None:
            light["bodies"] = np.zeros_like(expected.electrons)
        for name, image, place in self._seen(attitude):
            light["bodies"] += image.electrons
            bodies[name] = place
        expected = replace(expected, electrons=np.asarray(sum(light.values()), np.float32))
        detector, extra = self.sensor.detector, self.background_e_per_s
        if layers:
            dark = dark_electrons(detector, self.exposure_s, temperature_c=self.temperature_c, background_e_per_s=extra)
        return Observation(
            frame=expose(
                expected,
                self.sensor.detector,
                streams=self._streams,
                frame=frame,
                temperature_c=self.temperature_c,
                background_e_per_s=self.background_e_per_s,
            ),
            expected=expected,
            field=field,
            attitude=attitude,
            sensor=self.sensor,
            sky=self.sky,
            bodies=bodies,
            ghosts=ghosts,
            beside=beside,
            layers={name: image[..., 0] for name, image in light.items()} | {"dark": dark} if layers else None,
        )

    def stray_e_per_s(self, attitude: Rotation) -> dict[str, float]:
        """Stray light of each body in an attitude [e- s^-1 per pixel]; empty without a table."""
        return {} if self._stray is None else self._stray.even(attitude)

    def _motion(
        self, attitude: Rotation | Trajectory, rate_deg_per_s: ArrayLike | None, start_s: float | None
    ) -> tuple[Rotation, ExposureMotion | None]:
        """Attitude of the middle of the exposure, and the motion during it."""
        if isinstance(attitude, Rotation):
            if not attitude.single or start_s is not None:
                raise ConfigError("attitude must be one scipy Rotation, cam from icrs; start_s is for a trajectory")
            if rate_deg_per_s is None:
                return attitude, None
            turn = np.radians(np.asarray(rate_deg_per_s, float))
            if turn.shape != (3,) or not np.isfinite(turn).all():
                raise ConfigError(f"rate_deg_per_s = {rate_deg_per_s}: three finite numbers are needed, about x, y, z")
            first = Rotation.from_rotvec(0.5 * self.exposure_s * turn) * attitude
            path: Trajectory = ConstantRate(initial=first, rate_rad_per_s=turn, end_s=self.exposure_s)
        elif not hasattr(attitude, "attitude") or rate_deg_per_s is not None:
            raise ConfigError(
                "attitude must be one scipy Rotation, cam from icrs (optics.attitude_from_angles makes it), with a "
                "rate_deg_per_s or without, or a trajectory, which has its own rate"
            )
        else:
            path = attitude
        begin = path.start_s if start_s is None else start_s
        motion = exposure_motion(path, start_s=begin, exposure_s=self.exposure_s, camera=self.sensor.camera)
        return Rotation.from_matrix(motion.rotation_mid), motion

    def _view_of(self, motion: ExposureMotion | None) -> FieldOfView:
        """The field of view, wider where stars come in during an exposure."""
        out_px = 0.0 if motion is None else 0.5 * motion.length_px
        if out_px < 0.25 * MARGIN_PX:
            return self.view
        return field_of_view(self.sensor.camera, margin_px=MARGIN_PX + out_px)

    def _seen(self, attitude: Rotation) -> Iterator[tuple[str, ExpectedImage, tuple[float, float, float]]]:
        """Bodies that a frame shows: name, light, place and sum of that light."""
        if self._disks is None or self._points is None:
            return
        matrix, full_well_e = attitude.as_matrix(), self.sensor.detector.full_well_e
        for row, body in self._bodies.render_system(
            self._disks, matrix, exposure_s=self.exposure_s, ceiling_e=full_well_e
        ):
            if body.electrons[0] > 0.0:
                x, y = body.photon_px[0]
                yield self._disks.name[row], body.image, (float(x), float(y), float(body.electrons[0]))
        near = np.flatnonzero(self._points.direction @ matrix[2] > np.cos(self.view.radius_rad))
        for index in near:
            light = self._point_light
            one = replace(light, direction=light.direction[[index]], photon_rate=light.photon_rate[[index]])
            image = self._renderer.render(one, rotation_cam_from_world=matrix)
            truth = image.truth
            assert truth is not None
            if truth.electrons_image[0, 0] > 0.0:
                x, y, electrons = truth.photon_x_px[0, 0], truth.photon_y_px[0, 0], truth.electrons_image[0, 0]
                yield self._points.name[index], image, (float(x), float(y), float(electrons))

    def dark_dn(self, *, frames: int = 20) -> NDArray[np.float32]:
        """Mean (h, w) [DN] of dark frames with the exposure of the others: a master dark.

        `calib.subtract_dark` takes the fixed pattern and the dark current out of a frame with it.
        """
        total = np.zeros(self.sensor.detector.shape)
        for frame in range(frames):
            total += expose(
                np.zeros(self.sensor.detector.shape, np.float32),
                self.sensor.detector,
                streams=self._streams.child("dark"),
                frame=frame,
                exposure_s=self.exposure_s,
                temperature_c=self.temperature_c,
                band="dark",
            ).dn
        return np.asarray(total / frames, np.float32)


def observe(
    sensor: StarSensor,
    attitude: Rotation | Trajectory,
    sky: Sky | None = None,
    *,
    exposure_s: float | None = None,
    seed: int = 0,
    rate_deg_per_s: ArrayLike | None = None,
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
    layers : bool
        Whether the light of every source is also returned separately.
    **settings
        Any other setting of `SkySimulator`: ``passband=``, ``temperature_c=``, ``zodiacal=``, ``bodies=`` ...

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
    return simulator.observe(attitude, rate_deg_per_s=rate_deg_per_s, layers=layers)
