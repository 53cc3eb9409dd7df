"""From the sky to the renderer: which stars fall on the detector, and their light at the wavelength nodes.

`field_of` finds the stars and where they are seen; `star_light` prepares bands once; `star_field` makes the `StarField`
that `render.forward` renders, with directions along icrs: the camera's world is the sky.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import constants
from scipy.spatial.transform import Rotation

from optics.band import Band, band_nodes
from optics.chief import chief_ray_points
from optics.errors import ConfigError, DomainError
from optics.frames import field_angles_deg
from optics.paraxial import axial_paraxial
from optics.photometry import photon_rate
from optics.records import freeze
from optics.spectrum import Blackbody, Sed
from render.camera import Camera
from render.catalogue import StarCatalog
from render.catalogue_motion import Observer, directions_at
from render.catalogue_temperature import TYPICAL_TEMPERATURE_K, colour_temperature
from render.records import StarField
from render.sky_index import SkyIndex

__all__ = ["FieldOfView", "SkyField", "StarLight", "field_of", "field_of_view", "pointed", "star_field", "star_light"]

FloatArray = NDArray[np.float64]

_DEGREE = 9
_GRID = 25
_LIGHT_KM_PER_S = constants.c / 1e3
TEMPERATURE_KNOTS = 96
COLDEST_K, HOTTEST_K = 900.0, 70000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FieldOfView:
    """What a camera sees, without its attitude; made by `field_of_view`, once per camera.

    Attributes
    ----------
    width_px, height_px : int
        Size of the detector.
    margin_px : float
        Strip around it in which stars still count.
    radius_rad : float
        Half angle of the cone about +Z of cam that holds all of it.
    focal_length_mm : float
        Paraxial, at the design wavelength: the scale of the polynomial.
    coefficient : (t, 2)
        Polynomial in X/Z and Y/Z (scaled to the corner) for the column and row of the chief ray at the design
        wavelength.
    reach : float
        tan of the corner, the scale.
    residual_px : float
        Largest distance of the polynomial from the chief rays it was fitted to.
    """

    width_px: int
    height_px: int
    margin_px: float
    radius_rad: float
    focal_length_mm: float
    coefficient: FloatArray
    reach: float
    residual_px: float

    def __post_init__(self) -> None:
        freeze(self, "coefficient", shape=("t", 2), sizes={})

    def pixel_of(self, v_cam: FloatArray) -> FloatArray:
        """Column and row (n, 2) of directions (n, 3) in cam; NaN farther than ``radius_rad`` from +Z."""
        v = np.asarray(v_cam, np.float64)
        inside = v[:, 2] > math.cos(self.radius_rad) - 1e-12
        pixel = np.full((len(v), 2), np.nan)
        pixel[inside] = _terms(v[inside], self.reach) @ self.coefficient
        return pixel

    def on_detector(self, pixel_px: FloatArray) -> NDArray[np.bool_]:
        """Whether pixels (n, 2) lie on the detector or its margin."""
        x, y = pixel_px.T
        low = -0.5 - self.margin_px
        return (x >= low) & (y >= low) & (x <= self.width_px - 1 - low) & (y <= self.height_px - 1 - low)


def _terms(v_cam: FloatArray, reach: float) -> FloatArray:
    """Products of powers up to `_DEGREE` of X/Z and Y/Z, (n, t)."""
    x, y = v_cam[:, 0] / (v_cam[:, 2] * reach), v_cam[:, 1] / (v_cam[:, 2] * reach)
    powers_x, powers_y = (np.vander(u, _DEGREE + 1, increasing=True) for u in (x, y))
    return np.stack([powers_x[:, i] * powers_y[:, j] for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], 1)


def field_of_view(camera: Camera, *, margin_px: float = 16.0) -> FieldOfView:
    """Field of a camera from chief rays through its lens, distortion and all.

    Parameters
    ----------
    camera : Camera
        Its attitude plays no part.
    margin_px : float
        Strip around the detector in which stars still count, so that light of stars beside it comes in: the size of the
        spots.

    Returns
    -------
    FieldOfView
        With a polynomial of degree 9 for the chief ray at the design wavelength.

    Raises
    ------
    DomainError
        Margin negative or not finite.
    ConvergenceError
        The corner of the detector lies outside what the lens can image.
    """
    if not (margin_px >= 0.0 and math.isfinite(margin_px)):
        raise DomainError(f"margin_px = {margin_px}; it must be finite and not negative")
    lens = camera.focused_lens
    focal = abs(axial_paraxial(lens, lens.design_wavelength_nm).efl_mm)
    size = np.array([camera.width_px, camera.height_px])
    low, high = -0.5 - margin_px - camera.centre_px, size - 0.5 + margin_px - camera.centre_px
    half = np.maximum(np.abs(low), np.abs(high)) * camera.pixel_pitch_mm / focal
    for _ in range(3):  # widen until the edge of the grid images to the edge of the margin
        x, y = np.meshgrid(*(np.cos(np.pi * (np.arange(_GRID) + 0.5) / _GRID) * h for h in half))
        edge = (
            _chief_px(camera, np.array([half[0], 0.0, half[0]]), np.array([0.0, half[1], half[1]])) - camera.centre_px
        )
        short = np.maximum(np.abs(low), np.abs(high)) / np.array(
            [np.abs(edge[[0, 2], 0]).min(), np.abs(edge[[1, 2], 1]).min()]
        )
        if short.max() <= 1.0:
            break
        half = half * np.maximum(short * 1.002, 1.0)
    v = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    reach = float(np.hypot(*half))
    pixel = _chief_px(camera, x.ravel(), y.ravel())
    terms = _terms(v, reach)
    coefficient, *_ = np.linalg.lstsq(terms, pixel, rcond=None)
    return FieldOfView(
        width_px=camera.width_px,
        height_px=camera.height_px,
        margin_px=float(margin_px),
        radius_rad=math.atan(reach),
        focal_length_mm=focal,
        coefficient=np.asarray(coefficient, np.float64),
        reach=reach,
        residual_px=float(np.linalg.norm(terms @ coefficient - pixel, axis=1).max()),
    )


def _chief_px(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    """Pixels (n, 2) of chief rays at X/Z = x, Y/Z = y."""
    fx, fy = field_angles_deg(np.stack([x, y, np.ones_like(x)], axis=-1))
    return np.stack(camera.to_pixel(*chief_ray_points(camera.focused_lens, fx, fy)), axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyField:
    """The stars of a catalogue that one exposure sees.

    Attributes
    ----------
    stars : StarCatalog
        Their rows, at the epoch of the catalogue.
    row : (m,) int64
        Where they stand in the whole catalogue.
    direction : (m, 3)
        Where they are seen, unit vectors along icrs: moved to the epoch of the exposure, parallax and aberration
        included if an observer was given.
    pixel_px : (m, 2)
        Column and row of the chief ray at the design wavelength, by the polynomial of the field of view.
    rotation_cam_from_icrs : (3, 3)
        Attitude.
    """

    stars: StarCatalog
    row: NDArray[np.int64]
    direction: FloatArray
    pixel_px: FloatArray
    rotation_cam_from_icrs: FloatArray

    def __post_init__(self) -> None:
        sizes = {"m": len(self.stars)}
        freeze(self, "row", shape=("m",), dtype=np.int64, sizes=sizes)
        freeze(self, "direction", shape=("m", 3), sizes=sizes)
        freeze(self, "pixel_px", shape=("m", 2), sizes=sizes)
        freeze(self, "rotation_cam_from_icrs", shape=(3, 3))

    def __len__(self) -> int:
        return len(self.row)


def field_of(
    index: SkyIndex,
    view: FieldOfView,
    attitude: Rotation,
    *,
    magnitude_limit: float | None = None,
    epoch_year: float | None = None,
    observer: Observer | None = None,
) -> SkyField:
    """Stars that fall on the detector or the margin around it.

    Parameters
    ----------
    index : SkyIndex
        Catalogue with its search tree.
    view : FieldOfView
        What the camera sees.
    attitude : scipy.spatial.transform.Rotation
        cam from icrs.
    magnitude_limit : float, optional
        Faintest magnitude; stars without a magnitude are left out.
    epoch_year : float, optional
        Julian year of the exposure; that of the catalogue if left out.
    observer : Observer, optional
        Adds parallax and aberration (`render.catalogue_motion.earth_observer`).

    Returns
    -------
    SkyField
        Empty where no star is.

    Raises
    ------
    ConfigError
        Not a single rotation.
    DomainError
        Epoch or limit out of range.
    """
    if not isinstance(attitude, Rotation) or not attitude.single:
        raise ConfigError("attitude must be one scipy Rotation, cam from icrs")
    matrix = attitude.as_matrix()
    epoch = index.catalog.epoch_year if epoch_year is None else float(epoch_year)
    speed = 0.0 if observer is None else float(np.linalg.norm(observer.velocity_km_per_s))
    far = 0.0 if observer is None else float(np.linalg.norm(observer.position_au))
    # what may move in from outside; twice, for second orders
    slack = 2.0 * (
        abs(epoch - index.catalog.epoch_year) * index.fastest_rad_per_year
        + speed / _LIGHT_KM_PER_S
        + far * index.nearest_rad
    )
    boresight = matrix[2] / math.sqrt(float(matrix[2] @ matrix[2]))
    rows = index.within(boresight, min(view.radius_rad + slack, math.pi), magnitude_limit=magnitude_limit)
    stars = index.catalog.select(rows)
    direction = directions_at(stars, epoch, observer)
    pixel = view.pixel_of(direction @ matrix.T)
    seen = view.on_detector(pixel)
    return SkyField(
        stars=stars.select(seen),
        row=rows[seen],
        direction=direction[seen],
        pixel_px=pixel[seen],
        rotation_cam_from_icrs=matrix,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarLight:
    """Light of stars of any temperature in given bands; made by `star_light`, once per set of bands.

    Attributes
    ----------
    band : tuple of str
        Names of the b bands.
    wavelength_nm : (b, k)
        Nodes (`optics.band.band_nodes`).
    magnitude_system : {"V", "G"}
        Scale of the magnitudes that it takes.
    log_temperature : (s,)
        Knots, equally spaced in log T.
    spline : scipy.interpolate.CubicSpline
        Logarithm of the photon rate of a star of magnitude 0 at each node over log T, (b, k).
    """

    band: tuple[str, ...]
    wavelength_nm: FloatArray
    magnitude_system: Literal["V", "G"]
    log_temperature: FloatArray
    spline: Any

    def __post_init__(self) -> None:
        freeze(self, "wavelength_nm", shape=("b", "k"), sizes={"b": len(self.band)})
        freeze(self, "log_temperature", shape=("s",), sizes={})

    def photon_rate(self, magnitude: FloatArray, temperature_k: FloatArray) -> FloatArray:
        """Photons s^-1 mm^-2 that each node stands for, (n, b, k), of n stars.

        Raises
        ------
        DomainError
            A magnitude or temperature that is not finite, or a temperature outside the knots.
        """
        m, t = np.asarray(magnitude, np.float64), np.asarray(temperature_k, np.float64)
        low, high = np.exp(self.log_temperature[[0, -1]])
        for what, values, good, unit, advice in (
            ("magnitude", m, np.isfinite(m), "", "leave such stars out with a magnitude limit"),
            ("temperature", t, (t >= low) & (t <= high), " K", f"{low:.0f} ... {high:.0f} K is allowed"),
        ):
            if not good.all():
                at = int(np.argmin(good))
                raise DomainError(f"{what} of star {at} is {values[at]:g}{unit}; {advice}")
        return np.asarray(np.exp(self.spline(np.log(t)) - (0.4 * math.log(10.0)) * m[:, None, None]))


def star_light(
    bands: Sequence[Band],
    *,
    nodes: int = 5,
    magnitude_system: Literal["V", "G"] = "G",
    spectrum: Callable[[float], Sed] | None = None,
) -> StarLight:
    """Prepare bands: the light of a star of magnitude 0 against temperature, to be interpolated.

    Parameters
    ----------
    bands : sequence of Band
        b filters.
    nodes : int
        Wavelength nodes per band, k.
    magnitude_system : {"V", "G"}
        Scale of the magnitudes of the catalogue.
    spectrum : callable, optional
        Spectrum of a temperature [K]; black bodies if left out.

    Returns
    -------
    StarLight
        Exact at 96 temperatures from 900 to 70 000 K, a cubic spline in log T of the logarithm between them: below 1e-5
        of the rate between 1200 and 50 000 K for black bodies.

    Raises
    ------
    ConfigError, DomainError
        As `optics.band.band_nodes` and `optics.photometry.photon_rate`.
    """
    from scipy.interpolate import CubicSpline

    rule = band_nodes(bands, nodes)
    log_t = np.linspace(math.log(COLDEST_K), math.log(HOTTEST_K), TEMPERATURE_KNOTS)
    of = (lambda t: Blackbody(temperature_k=t)) if spectrum is None else spectrum
    rates = [
        photon_rate(of(float(t)), 0.0, wavelength_nm=rule.wavelength_nm, system=magnitude_system) for t in np.exp(log_t)
    ]
    light = np.array(rates) * rule.weight_nm * rule.transmission
    if not (light > 0.0).all():
        raise DomainError("a band has a wavelength node without light; leave out its dark parts")
    return StarLight(
        band=rule.name,
        wavelength_nm=rule.wavelength_nm,
        magnitude_system=magnitude_system,
        log_temperature=log_t,
        spline=CubicSpline(log_t, np.log(light)),
    )


def star_field(
    field: SkyField,
    light: StarLight,
    *,
    temperature: Literal["colour", "effective"] = "colour",
    typical_temperature_k: float | None = TYPICAL_TEMPERATURE_K,
) -> StarField:
    """The stars of a field with their light, ready to be rendered by a camera whose world is icrs.

    Parameters
    ----------
    field : SkyField
        m stars.
    light : StarLight
        Bands, prepared for the magnitude system of the catalogue.
    temperature : {"colour", "effective"}
        Temperature of the black body that stands for a star: the one that has the star's colour, or the star's
        effective temperature. A star without the one gets the other.
    typical_temperature_k : float or None
        For stars that have neither; None refuses them.

    Returns
    -------
    StarField
        Directions along icrs. Rotate the camera (`rotation_cam_from_world = field.rotation_cam_from_icrs`), not the
        stars.

    Raises
    ------
    ConfigError
        Another magnitude system than the catalogue's, unknown kind of temperature.
    DomainError
        A star without magnitude, or without temperature where those are refused.
    """
    if light.magnitude_system != field.stars.magnitude_system:
        raise ConfigError(
            f"bands were prepared for {light.magnitude_system} magnitudes, the catalogue has "
            f"{field.stars.magnitude_system}; star_light(..., magnitude_system={field.stars.magnitude_system!r})"
        )
    if temperature not in ("colour", "effective"):
        raise ConfigError(f"temperature = {temperature!r}; 'colour' or 'effective' is needed")
    by_colour = colour_temperature(field.stars.bp_rp_mag, field.stars.b_v_mag)
    known = (by_colour, field.stars.effective_temperature_k)
    first, second = known if temperature == "colour" else known[::-1]
    kelvin = np.where(np.isnan(first), second, first)
    if typical_temperature_k is not None:
        kelvin = np.where(np.isnan(kelvin), typical_temperature_k, kelvin)
    if np.isnan(kelvin).any():
        at = int(np.argmax(np.isnan(kelvin)))
        raise DomainError(f"star {field.stars.id[at]} has no colour, so no temperature; give typical_temperature_k")
    return StarField(
        direction=field.direction,
        wavelength_nm=light.wavelength_nm,
        photon_rate=light.photon_rate(field.stars.magnitude, kelvin),
        band=light.band,
    )


def pointed(camera: Camera, field: SkyField) -> Camera:
    """The camera in the attitude for which the field was looked up."""
    return replace(camera, rotation_cam_from_world=field.rotation_cam_from_icrs)
