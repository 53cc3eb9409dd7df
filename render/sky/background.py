r"""Diffuse light of the sky through a lens: zodiacal light and a uniform sky, electrons per second in every pixel.

A pixel takes in the radiance L of the sky times its etendue,

.. math:: \dot{N} = \sum_k L(\lambda_k) w_k\, E(\lambda_k), \qquad
          E = A_{pupil} \cos\theta\, \tau(field)\, \Omega_{pixel}

with the area of the launch disk, the share tau of its rays that reach the image plane, the solid angle of sky that the
pixel sees (from the derivative of the map of traced rays), and the weights w of filter, response of the camera and
quadrature. The etendue is traced once per camera and set of bands (`background_map`); a frame costs the radiance on a
coarse grid of directions, a spline through it, and one product per pixel (`sky_background`).

Light is taken as spread evenly over the field within a spot's width: blur and charge diffusion do not change it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.light.band import Band, band_nodes
from optics.light.magnitudes import band_integral, photon_rate
from optics.light.spectrum import Sed
from optics.rays.spots import spot_moments
from optics.records import freeze_all
from render.camera import Camera
from render.catalogue.motion import Observer, earth_observer
from render.sky.field import FieldOfView, field_of_view
from render.sky.sunlight import sun_spectrum, sunlight
from render.sky.zodiacal import zodiacal_radiance

SQUARE_ARCSEC_SR = (math.pi / 180.0 / 3600.0) ** 2
TRACED_NODES = 13
"""Places per axis at which the etendue is traced; a spline runs between them."""
ARMS = 48
"""Azimuths at which the outlines of beams are traced."""
TRACED_WAVELENGTHS = 3
NODE_STEP_RAD = math.radians(1.0)
"""Distance of the places at which the radiance of a frame is computed; the table changes over 5 deg and more."""
FEWEST_NODES, MOST_NODES = 5, 33
BLOCK_ROWS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class UniformSky:
    """A sky of uniform brightness: unresolved stars, airglow, stray light of a laboratory.

    Attributes
    ----------
    magnitude_per_arcsec2 : float
        Surface brightness.
    system : {"V", "G"}
        Scale of the magnitude.
    spectrum : Sed or None
        Shape of its spectrum; sunlight if left out.

    Raises
    ------
    DomainError
        Magnitude not finite.
    """

    magnitude_per_arcsec2: float
    system: Literal["V", "G"] = "V"
    spectrum: Sed | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.magnitude_per_arcsec2):
            raise DomainError(f"sky of {self.magnitude_per_arcsec2} mag/arcsec^2; a finite magnitude is needed")

    def radiance(self, wavelength_nm: FloatArray) -> FloatArray:
        """Photons s^-1 mm^-2 sr^-1 nm^-1 at each wavelength [nm], any shape."""
        shape = sun_spectrum() if self.spectrum is None else self.spectrum
        rate = photon_rate(shape, self.magnitude_per_arcsec2, wavelength_nm=wavelength_nm, system=self.system)
        return np.asarray(rate / SQUARE_ARCSEC_SR)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BackgroundMap:
    """Etendue of each pixel of a camera for a diffuse sky; made by `background_map`."""

    band: tuple[str, ...]  # Names of the b bands
    # wavelength_nm, weight_nm: (b, k) Nodes, and the weights of filter, camera's response and quadrature together
    wavelength_nm: FloatArray
    weight_nm: FloatArray
    # (b,) What the nodes miss of a spectrum as rough as the Sun's: its integral over all its pieces against theirs
    sunlight_factor: FloatArray
    etendue_mm2_sr: NDArray[np.float32]  # (h, w, b) Etendue of every pixel, mean over the band for sunlight
    direction: FloatArray  # (gy, gx, 3) Unit vectors in cam at a coarse grid of pixels
    # spline_x, spline_y: (gx, w), (h, gy) Cubic splines from that grid to all columns and rows
    spline_x: NDArray[np.float32]
    spline_y: NDArray[np.float32]

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"b": len(self.band)}
        freeze_all(self, wavelength_nm=("b", "k"), weight_nm=("b", "k"), sunlight_factor=("b",), sizes=sizes)
        freeze_all(self, direction=("gy", "gx", 3), sizes=sizes)
        freeze_all(self, etendue_mm2_sr=("h", "w", "b"), dtype=np.float32, sizes=sizes)
        freeze_all(self, spline_x=("gx", "w"), spline_y=("h", "gy"), dtype=np.float32, sizes=sizes)


def background_map(camera: Camera, bands: Sequence[Band], *, nodes: int = 5) -> BackgroundMap:
    """Trace the etendue of every pixel for a diffuse sky; once per camera (whose attitude plays no part) and bands."""
    rule = band_nodes(bands, nodes)
    wavelength = rule.wavelength_nm
    camera.lens.check_wavelength(wavelength)
    weight = rule.weight_nm * rule.transmission * camera.response_at(wavelength)
    knots = sun_spectrum().wavelength_nm
    exact = [band_integral(b, lambda at: sunlight(at) * camera.response_at(at), breakpoints_nm=knots) for b in bands]
    view = field_of_view(camera, margin_px=2.0)
    columns, rows = _nodes(camera.width_px, TRACED_NODES), _nodes(camera.height_px, TRACED_NODES)
    tangent = _tangents(view, camera, columns, rows)
    etendue = _etendue(camera, view, tangent, wavelength, weight * sunlight(wavelength))
    across, down = _spline(columns, camera.width_px), _spline(rows, camera.height_px)
    every = np.einsum("hj,wi,jib->hwb", down, across, etendue, optimize=True)
    half = np.arctan(view.half_width)
    coarse = [
        _nodes(size, int(np.clip(math.ceil(2.0 * angle / NODE_STEP_RAD) + 1, FEWEST_NODES, MOST_NODES)))
        for size, angle in zip((camera.width_px, camera.height_px), half, strict=True)
    ]
    return BackgroundMap(
        band=rule.name,
        wavelength_nm=wavelength,
        weight_nm=weight,
        sunlight_factor=exact / (weight * sunlight(wavelength)).sum(1),
        etendue_mm2_sr=np.maximum(every, 0.0),
        direction=_unit(_tangents(view, camera, *coarse)),
        spline_x=_spline(coarse[0], camera.width_px).T,
        spline_y=_spline(coarse[1], camera.height_px),
    )


def sky_background(
    background: BackgroundMap,
    attitude: Rotation,
    *,
    epoch_year: float | None = None,
    observer: Observer | None = None,
    zodiacal: bool = True,
    uniform: UniformSky | None = None,
) -> NDArray[np.float32]:
    """Electrons per second of the diffuse sky in every pixel, (h, w, b) float32; the attitude is cam from icrs.

    Zodiacal light needs an epoch (Julian year, for an observer at the Earth) or an observer, as seen from the Sun, and
    ends 15 deg from the Sun (`DomainError`); ``uniform`` comes on top of it.
    """
    if not isinstance(attitude, Rotation) or not attitude.single:
        raise ConfigError("attitude must be one scipy Rotation, cam from icrs")
    grid = background.direction.shape[:2]
    rate = np.zeros((len(background.band), *grid))
    weight = background.weight_nm
    if zodiacal:
        from_sun_au = _from_sun(epoch_year, observer)
        icrs = background.direction.reshape(-1, 3) @ attitude.as_matrix()
        radiance = zodiacal_radiance(icrs, from_sun_au=from_sun_au, wavelength_nm=background.wavelength_nm.ravel())
        rate += np.einsum(
            "nbk,bk,b->bn", radiance.reshape(-1, *weight.shape), weight, background.sunlight_factor
        ).reshape(rate.shape)
    if uniform is not None:
        light = (uniform.radiance(background.wavelength_nm) * weight).sum(1)
        rate += (light * (background.sunlight_factor if uniform.spectrum is None else 1.0))[:, None, None]
    image = np.empty(background.etendue_mm2_sr.shape, np.float32)
    for band in range(len(background.band)):
        rows = background.spline_y @ rate[band].astype(np.float32)
        for start in range(0, len(image), BLOCK_ROWS):  # what is multiplied has not left the cache
            part = slice(start, start + BLOCK_ROWS)
            smooth = rows[part] @ background.spline_x
            np.multiply(smooth, background.etendue_mm2_sr[part, :, band], out=image[part, :, band])
    return image


def _from_sun(epoch_year: float | None, observer: Observer | None) -> FloatArray:
    if observer is None:
        if epoch_year is None:
            raise ConfigError("zodiacal light needs epoch_year or observer; zodiacal=False leaves it out")
        observer = earth_observer(epoch_year)
    if observer.from_sun_au is None:
        raise ConfigError("zodiacal light needs an observer with from_sun_au; zodiacal=False leaves it out")
    return observer.from_sun_au


def _nodes(size_px: int, count: int) -> FloatArray:
    """Pixel coordinates from edge to edge."""
    return np.linspace(-0.5, size_px - 0.5, count)


def _spline(nodes: FloatArray, size_px: int) -> NDArray[np.float32]:
    """Matrix (size, nodes) of the cubic spline (not-a-knot) through values at the nodes."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(nodes, np.eye(len(nodes)))(np.arange(size_px)), np.float32)


def _unit(tangent: FloatArray) -> FloatArray:
    v = np.concatenate([tangent, np.ones((*tangent.shape[:-1], 1))], axis=-1)
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _tangents(view: FieldOfView, camera: Camera, columns: FloatArray, rows: FloatArray) -> FloatArray:
    """X/Z and Y/Z (rows, columns, 2) of the chief rays that land on a grid of pixels: Newton's method."""
    wanted = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    edge = np.array([camera.width_px, camera.height_px])
    tangent = (wanted - camera.centre_px) / (0.5 * edge) * view.half_width * 0.9
    for _ in range(30):
        tangent = np.clip(tangent, -view.half_width, view.half_width)
        off = wanted - _landing(view, tangent)
        if np.abs(off).max() < 1e-6:
            return tangent.reshape(len(rows), len(columns), 2)
        tangent = tangent + np.linalg.solve(_slope(view, tangent), off[..., None])[..., 0]
    raise ConvergenceError("a pixel of the detector has no unique direction: its chief rays fold back")


def _landing(view: FieldOfView, tangent: FloatArray) -> FloatArray:
    return view.pixel_of(np.column_stack([tangent, np.ones(len(tangent))]))


def _slope(view: FieldOfView, tangent: FloatArray) -> FloatArray:
    """Derivative (n, 2, 2) of column and row by X/Z and Y/Z, by differences inside the field."""
    slope = np.empty((len(tangent), 2, 2))
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 1e-4 * view.half_width[axis]
        high = np.minimum(tangent + step, view.half_width)
        low = np.maximum(tangent - step, -view.half_width)
        slope[:, :, axis] = (_landing(view, high) - _landing(view, low)) / (high - low)[:, axis, None]
    return slope


def _etendue(
    camera: Camera, view: FieldOfView, tangent: FloatArray, wavelength_nm: FloatArray, light: FloatArray
) -> FloatArray:
    """Etendue (rows, columns, b) [mm^2 sr] of pixels, mean over the wavelengths with ``light`` (b, k) as weight."""
    t = tangent.reshape(-1, 2)
    v = _unit(t)
    solid_angle = v[:, 2] ** 3 / np.abs(np.linalg.det(_slope(view, t)))  # d(tan) d(tan) cos^3 is a solid angle
    low, high = wavelength_nm.min(), wavelength_nm.max()
    traced = np.unique(np.linspace(low, high, TRACED_WAVELENGTHS))
    area = spot_moments(camera.focused_lens, *field_angles_deg(v), traced, order=(1, ARMS)).transmitted_mm2
    # a polynomial through the traced wavelengths
    basis = np.ones((*wavelength_nm.shape, len(traced)))
    for i, at in enumerate(traced):
        for other in np.delete(traced, i):
            basis[..., i] *= (wavelength_nm - other) / (at - other)
    mean = np.einsum("bk,bki,ni->nb", light / light.sum(1, keepdims=True), basis, area)
    return np.asarray((v[:, 2] * solid_angle)[:, None] * mean).reshape(*tangent.shape[:2], -1)
