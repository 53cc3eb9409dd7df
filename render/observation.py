"""Light of a frame of the sky by source, and the observation that a sensor makes of it: table, figure, page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.attitude import angles_from_attitude
from optics.frame_html import Marks, differences, save_frame_page
from optics.frames import equatorial_deg
from render.bodies.solar_system import SolarSystem
from render.fits.wcs import lens_wcs, sky_grid
from render.records import ExpectedImage, Frame, StarField, Truth
from render.sensor import StarSensor
from render.sky.field import SkyField
from render.sky.sky import Sky
from render.tracing.ghosts import GhostTruth

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from render.bodies.body_image import BodyImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyDisk:
    """A body larger than a pixel in a frame."""

    name: str
    row: int  # In the simulator's ``disks``
    image: BodyImage  # Its light on the detector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyLight:
    """What falls on the detector in one exposure, in one pass band; made by `SkySimulator.expected`."""

    electrons: NDArray[np.float32]  # (h, w) Expected photo-electrons: the sum of the layers
    # (h, w) By source, as far as the simulator has it: ``stars`` (with planets smaller than a pixel), ``scatter``
    # (their halos), ``ghosts``, ``sky`` (zodiacal and other diffuse light), ``stray`` (Sun, Moon, Earth outside the
    # field), ``bodies`` (larger than a pixel)
    layers: dict[str, NDArray[np.float32]]
    sources: StarField  # n points of light, along icrs or in the world of the caller's stars: stars, then planets
    truth: Truth  # True positions and light balance (n, 1) of the sources
    field: SkyField | None  # Catalogue rows, apparent directions of the stars; None for stars of the caller
    planets: SolarSystem | None  # The sources behind the stars; None without any
    disks: tuple[BodyDisk, ...]  # Bodies larger than a pixel, the nearest first
    ghosts: GhostTruth | None  # Rows from ``len(field)`` on count in ``sources_outside``
    sources_outside: tuple[str, ...]  # Sources of ghosts outside the field: ids of stars in front of the lens, bodies
    attitude: Rotation  # cam from icrs in the middle of the exposure
    band: str  # Name of the pass band
    exposure_s: float

    @property
    def bodies(self) -> dict[str, tuple[float, float, float]]:
        """Column and row [px] of the centroid, and electrons, of each body whose light reaches the detector."""
        bodies = {
            disk.name: (*disk.image.photon_px[0].tolist(), float(disk.image.electrons[0]))
            for disk in self.disks
            if disk.image.electrons[0] > 0.0
        }
        names = () if self.planets is None else self.planets.name
        for row, name in enumerate(names, len(self.sources) - len(names)):
            x, y, electrons = (
                float(getattr(self.truth, column)[row, 0])
                for column in ("photon_x_px", "photon_y_px", "electrons_image")
            )
            if electrons > 0.0:
                bodies[name] = x, y, electrons
        return bodies

    def image(self) -> ExpectedImage:
        """The electrons as `expose` and FITS files take them, with the truth."""
        return ExpectedImage(
            electrons=self.electrons[:, :, None],
            band=(self.band,),
            exposure_s=self.exposure_s,
            diffused=True,
            truth=self.truth,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Observation:
    """A frame of the sky with its truth, attitude and settings.

    Attributes
    ----------
    frame : Frame
        What the detector gave out.
    light : SkyLight
        Expected electrons by source, the sources themselves and their truth.
    sensor : StarSensor
        Camera and detector.
    sky : Sky
        All stars of the sky, as known to a star identifier.
    layers : dict of str to (h, w) float32, or None
        Expected electrons by source, if requested: those of ``light``, which add up to ``expected``, and ``dark``, the
        detector's contribution: dark current of every pixel and ``background_e_per_s``.
    """

    frame: Frame
    light: SkyLight
    sensor: StarSensor
    sky: Sky
    layers: dict[str, NDArray[np.float32]] | None = None

    def __repr__(self) -> str:
        ra, dec, roll = angles_from_attitude(self.attitude)
        height, width = self.frame.dn.shape
        return (
            f"<Observation at ra {ra:.4f}, dec {dec:.4f}, roll {roll:.4f} deg: {width} x {height} px, "
            f"{self.frame.exposure_s:g} s, {len(self.field)} stars>"
        )

    @property
    def attitude(self) -> Rotation:
        """cam from icrs in the middle of the exposure."""
        return self.light.attitude

    @property
    def field(self) -> SkyField:
        """The stars of the truth, in the same order: catalogue rows, directions."""
        assert self.light.field is not None
        return self.light.field

    @property
    def truth(self) -> Truth:
        """True positions and light balance of every star."""
        return self.light.truth.select(slice(len(self.field)))

    @property
    def expected(self) -> ExpectedImage:
        """Expected electrons of the frame, diffuse light included, with the truth of every point of light."""
        return self.light.image()

    @property
    def bodies(self) -> dict[str, tuple[float, float, float]]:
        """Column and row [px] of the centroid, and electrons, of each of the simulator's bodies in the frame."""
        return self.light.bodies

    @property
    def ghosts(self) -> GhostTruth | None:
        """Ghosts in the frame; their stars count in ``field``, from ``len(field)`` on in ``sources_outside``."""
        return self.light.ghosts

    @property
    def sources_outside(self) -> tuple[str, ...]:
        """Sources of ghosts outside the field: ids of bright stars anywhere in front of the lens, bodies."""
        return self.light.sources_outside

    def to_table(self) -> Any:
        """Truth as an `astropy.table.Table`: a row per star with identity, position and electrons."""
        from astropy import units
        from astropy.table import Table

        stars, truth, table = self.field.stars, self.truth, Table()
        ra_deg, dec_deg = equatorial_deg(self.field.direction)
        table["star_id"] = np.array(stars.id)
        table["ra"], table["dec"] = ra_deg * units.deg, dec_deg * units.deg
        table["magnitude"] = stars.magnitude * units.mag
        table["temperature"] = self.sky.temperature_k[self.field.row] * units.K
        for name in Truth.__dataclass_fields__:
            base, unit = name.rsplit("_", 1) if name.endswith(("_px", "_px2")) else (name, "")
            table[base] = getattr(truth, name)[:, 0]
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
        given = [replace(layer, shown=layer.shape != "arrow") for layer in layers]  # the truth says more than residuals
        cards = lens_wcs(self.sensor.camera).header(self.attitude.as_matrix())
        ra, dec, roll = angles_from_attitude(self.attitude)
        return save_frame_page(
            path,
            frame.dn,
            [true, *given, *([differences(measured, true)] if measured else [])],
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
        ra_deg, dec_deg = equatorial_deg(self.field.direction[rows])
        return Marks(
            name="true stars",
            x_px=truth.photon_x_px[rows, 0],
            y_px=truth.photon_y_px[rows, 0],
            label=[f"{magnitude:.1f}" for magnitude in stars.magnitude[rows]],
            columns={
                "star": np.asarray(stars.id)[rows],
                "magnitude": stars.magnitude[rows],
                "temperature [K]": np.rint(self.sky.temperature_k[self.field.row[rows]]),
                "right ascension [deg]": ra_deg,
                "declination [deg]": dec_deg,
                "light [e-]": electrons[rows],
            },
        )
