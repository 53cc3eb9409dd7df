"""World coordinates of a camera: the distortion of its traced lens as a FITS header (TAN-SIP).

Pixels become directions in three steps (Shupe et al. 2005, ASP Conf. Ser. 347, 491; Calabretta & Greisen 2002, A&A 395,
1077): with (u, v) = FITS pixel - CRPIX,

    U = u + sum A_p_q u^p v^q,   V = v + sum B_p_q u^p v^q,   2 <= p + q <= order
    (xi, eta) = CD (U, V)         [deg]
    direction = unit(b + tan1 xi E + tan1 eta N),  tan1 = pi / 180

about the boresight b (CRVAL), with E and N towards east and north there (LONPOLE = 180, written because its default
turns over at the pole). AP and BP lead from (U, V) back to (u, v) in the same way; ds9 uses them, astropy iterates.

The polynomials belong to the camera and are fitted once, in the image plane, to chief rays traced through the lens. An
attitude changes only CRVAL and CD. CD has a positive determinant: our rows count downwards, FITS viewers draw them
upwards and show the sky mirrored, as they do with any image stored from its top row on.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.io import fits
from numpy.typing import ArrayLike

from optics.arrays import FloatArray, IntArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import pixel_to_fits
from optics.rays.paraxial import axial_paraxial
from optics.records import freeze_all
from optics.units import RAD_DEG
from render.camera import Camera
from render.fits.headers import Card

if TYPE_CHECKING:
    from astropy.wcs import WCS

HIGHEST_ORDER = 9
"""Highest order of a SIP polynomial that astropy and ds9 read (Shupe et al. 2005)."""

_LOWEST_ORDER = 2
_AIM_STEPS = 25
_AIM_PX = 0.02
_FIT_NODES = 20
_CHECK_NODES = 23
_LARGEST_RESIDUAL_PX = 0.01
_NEGLIGIBLE_PX = 1e-8
_LARGEST_RETURN_PX, _LARGEST_RETURN_RAD = 0.1, 2e-6
"""Distance of a star from the direction of its pixel; FK4 and back is good to some 0.1 arcsec."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensWcs:
    """World coordinates of a camera, all but its attitude; made by `lens_wcs`."""

    boresight_px: FloatArray  # (2,) Column and row at which a star on the boresight (+Z of cam) is seen
    linear: FloatArray  # (2, 2) (X/Z, Y/Z) in cam per pixel (column, row) at that place
    order: int  # Order of A and B, 2 to 9
    # a, b: (order + 1, order + 1) Forward polynomials, ``a[p, q]`` of u^p v^q
    a: FloatArray
    b: FloatArray
    inverse_order: int  # Order of AP and BP
    # ap, bp: (inverse_order + 1, inverse_order + 1) Inverse polynomials
    ap: FloatArray
    bp: FloatArray
    wavelength_nm: float  # Wavelength of the chief rays
    # residual_px, inverse_residual_px: Largest distance on the detector between traced chief rays (others than those
    # of the fit) and the place where the forward and the inverse polynomials put them
    residual_px: float
    inverse_residual_px: float
    _constant: tuple[Card, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        forward, inverse = (2 * (order + 1,) for order in (self.order, self.inverse_order))
        freeze_all(self, boresight_px=(2,), linear=(2, 2), a=forward, b=forward, ap=inverse, bp=inverse)
        object.__setattr__(self, "_constant", tuple(_constant_cards(self)))

    def field_deg(self, width_px: int, height_px: int) -> tuple[float, float]:
        """Field of view along columns and rows, at the scale of the boresight."""
        scale = math.sqrt(abs(float(np.linalg.det(self.linear))))
        width, height = (math.degrees(2.0 * math.atan(0.5 * scale * size)) for size in (width_px, height_px))
        return width, height

    def header(self, rotation_cam_from_icrs: ArrayLike) -> list[Card]:
        """Header cards of an exposure."""
        rotation = np.asarray(rotation_cam_from_icrs, np.float64)
        if rotation.shape != (3, 3):
            raise DomainError(f"rotation_cam_from_icrs has shape {rotation.shape}; a 3 x 3 matrix is needed")
        proper = np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-9) and np.linalg.det(rotation) > 0.0
        if not proper:  # NaN fails too
            raise DomainError("rotation_cam_from_icrs is no proper rotation (a mirrored sky has determinant -1)")
        x, y, z = rotation.tolist()
        across = math.hypot(z[0], z[1])
        right_ascension, declination = math.atan2(z[1], z[0]), math.atan2(z[2], across)
        east = (-math.sin(right_ascension), math.cos(right_ascension), 0.0)
        north = (-math.sin(declination) * east[1], math.sin(declination) * east[0], math.cos(declination))
        (l11, l12), (l21, l22) = self.linear.tolist()
        cd = []
        for axis in (east, north):
            along_x, along_y = _dot(x, axis) * RAD_DEG, _dot(y, axis) * RAD_DEG
            cd += [along_x * l11 + along_y * l21, along_x * l12 + along_y * l22]
        return [
            ("WCSAXES", 2, "right ascension and declination"),  # before all others (FITS standard 4.0, sec. 8.2)
            ("CRVAL1", right_ascension * RAD_DEG % 360.0, "[deg] right ascension of the boresight"),
            ("CRVAL2", declination * RAD_DEG, "[deg] declination of the boresight"),
            ("CD1_1", cd[0], "[deg/px] eastwards along columns"),
            ("CD1_2", cd[1], "[deg/px] eastwards along rows"),
            ("CD2_1", cd[2], "[deg/px] northwards along columns"),
            ("CD2_2", cd[3], "[deg/px] northwards along rows"),
            *self._constant,
        ]


def lens_wcs(camera: Camera, *, wavelength_nm: float | None = None, tolerance_px: float = 1e-3) -> LensWcs:
    """Fit world coordinates to a camera's lens.

    Parameters
    ----------
    camera : Camera
        Its attitude plays no part.
    wavelength_nm : float, optional
        Wavelength of the chief rays, e.g. the mean of a band; the design wavelength by default.
    tolerance_px : float
        The order is raised until both polynomials are that good, at most 0.01; order 9 is taken if it reaches 0.01 px.

    Returns
    -------
    LensWcs
        Linear part and both polynomials, with their errors [px].

    Raises
    ------
    DomainError
        Tolerance out of range.
    ConvergenceError
        The corners of the detector lie outside what the lens can image, or order 9 does not reach 0.01 px.
    """
    if not 0.0 < tolerance_px <= _LARGEST_RESIDUAL_PX:
        raise DomainError(
            f"tolerance_px = {tolerance_px:g} px; it must be above 0, at most {_LARGEST_RESIDUAL_PX:g} px"
        )
    wavelength = camera.lens.design_wavelength_nm if wavelength_nm is None else float(wavelength_nm)
    centre = camera.chief_px(np.zeros(1), np.zeros(1), wavelength)[0]
    nodes = np.cos(np.pi * (np.arange(_FIT_NODES) + 0.5) / _FIT_NODES)
    plane, pixel = _rays_at(camera, nodes / nodes[0], wavelength)
    check_plane, check_pixel = _rays_at(camera, np.linspace(-1.0, 1.0, _CHECK_NODES), wavelength)
    pixel, check_pixel = pixel - centre, check_pixel - centre
    forward, linear, residual = _raised(pixel, plane, check_pixel, check_plane, None, tolerance_px)
    ideal, check_ideal = _solved(linear, plane), _solved(linear, check_plane)
    backward, _, inverse_residual = _raised(ideal, pixel, check_ideal, check_pixel, np.eye(2), tolerance_px)
    if not max(residual, inverse_residual) <= _LARGEST_RESIDUAL_PX:
        raise ConvergenceError(
            f"lens {camera.lens.name!r} on {camera.width_px} x {camera.height_px} px: SIP of order {HIGHEST_ORDER} "
            f"misses its chief rays by {residual:.2g} px (inverse {inverse_residual:.2g} px), at most "
            f"{_LARGEST_RESIDUAL_PX:g} px is allowed; use a smaller detector"
        )
    return LensWcs(
        boresight_px=centre,
        linear=linear,
        order=len(forward) - 1,
        a=forward[:, :, 0],
        b=forward[:, :, 1],
        inverse_order=len(backward) - 1,
        ap=backward[:, :, 0],
        bp=backward[:, :, 1],
        wavelength_nm=wavelength,
        residual_px=residual,
        inverse_residual_px=inverse_residual,
    )


def sky_grid(header: fits.Header | Iterable[Card], shape: tuple[int, int], *, nodes: int = 65) -> FloatArray | None:
    """Directions over a frame, for `optics.frame_html.frame_page`."""
    # -> (nodes, nodes, 3)
    grid = _directions(header, shape, nodes)
    return grid if grid is not None and np.isfinite(grid).all() else None


def catalogue_pixels(
    header: fits.Header, shape: tuple[int, int], direction: FloatArray
) -> tuple[IntArray, FloatArray] | None:
    """Stars in a frame, by its world coordinates.

    Parameters
    ----------
    header : Header
        Any celestial system, equinox, order of axes and projection that astropy knows.
    shape : tuple of int
        Rows and columns.
    direction : (n, 3)
        Unit vectors along icrs.

    Returns
    -------
    (m,) and (m, 2), or None
        Rows of ``direction`` and pixels (x, y); None: the header has no usable world coordinates.
    """
    from astropy.coordinates import SkyCoord

    grid = _directions(header, shape, 65)
    if grid is None or not np.isfinite(grid).any():
        return None
    # A cap about the frame: distortion polynomials diverge far from it
    visible = grid[np.isfinite(grid).all(axis=2)]
    centre = visible.sum(axis=0) / max(float(np.linalg.norm(visible.sum(axis=0))), 1e-12)
    radius = 1.1 * math.acos(float(np.clip((visible @ centre).min(), -1.0, 1.0))) + 1e-3
    rows = np.flatnonzero(direction @ centre >= math.cos(min(radius, math.pi)))
    sky = SkyCoord(*direction[rows].T, representation_type="cartesian", frame="icrs")
    with _quiet():
        world = _celestial(header)
        x, y = world.world_to_pixel(sky)
        size = np.array(shape[::-1])
        position = np.stack([x, y], axis=-1)
        inside = (np.abs(position - 0.5 * (size - 1)) <= 0.5 * size).all(axis=1)
        # Directions behind the projection, and false solutions of polynomials, do not lead back
        back = world.pixel_to_world(*position[inside].T).icrs.cartesian.xyz.value.T
    scale = np.radians(np.sqrt(abs(np.linalg.det(world.pixel_scale_matrix))))
    miss = np.linalg.norm(back - direction[rows[inside]], axis=1)
    chosen = np.flatnonzero(inside)[miss < max(_LARGEST_RETURN_PX * scale, _LARGEST_RETURN_RAD)]
    return rows[chosen], position[chosen]


@contextmanager
def _quiet() -> Iterator[None]:
    """Without warnings and remarks of astropy and wcslib about headers of others."""
    from astropy import log

    level = log.level
    log.setLevel("ERROR")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


def _celestial(header: fits.Header) -> WCS:
    from astropy.wcs import WCS

    world = WCS(header, naxis=2)  # .celestial would exchange swapped axes, pixels included
    if any(kind.startswith("GLON") for kind in world.wcs.ctype):
        world.wcs.radesys = ""  # means nothing here, but astropy would obey it
    return world


def _directions(header: fits.Header | Iterable[Card], shape: tuple[int, int], nodes: int) -> FloatArray | None:
    """Directions (nodes, nodes, 3) over a frame, NaN off the sky; None without usable world coordinates."""
    cards = header if isinstance(header, fits.Header) else fits.Header(list(header))
    with _quiet():
        try:
            world = _celestial(cards)
            if not world.has_celestial:
                return None
            x, y = np.meshgrid(*(np.linspace(-0.5, size - 0.5, nodes) for size in reversed(shape)))
            directions = world.pixel_to_world(x, y).icrs.cartesian.xyz.value
        except Exception:  # wcslib and astropy raise what they happen to raise over headers of others
            return None
    return np.moveaxis(np.asarray(directions, np.float64), 0, -1)


def _rays_at(camera: Camera, nodes: FloatArray, wavelength_nm: float) -> tuple[FloatArray, FloatArray]:
    """(X/Z, Y/Z) and pixels (n, 2) of chief rays on a grid that spans the detector; -1 and 1 are its edges."""
    size = np.array([camera.width_px, camera.height_px])
    column, row = (0.5 * (size - 1)[:, None] + 0.5 * size[:, None] * nodes).tolist()
    wanted = np.stack([axis.ravel() for axis in np.meshgrid(column, row)], axis=-1)
    scale = camera.pixel_pitch_mm / abs(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
    plane = (wanted - camera.centre_px) * scale
    for _ in range(_AIM_STEPS):  # as far as distortion is small against the image this converges; a node may lie off
        pixel = camera.chief_px(plane[:, 0], plane[:, 1], wavelength_nm)
        short = wanted - pixel
        if np.abs(short).max() < _AIM_PX:
            return plane, pixel
        plane = plane + short * scale
    raise ConvergenceError(
        f"lens {camera.lens.name!r}: no chief ray reaches the corners of {size[0]} x {size[1]} px; "
        "use a smaller detector"
    )


def _raised(
    x: FloatArray,
    y: FloatArray,
    check_x: FloatArray,
    check_y: FloatArray,
    linear: FloatArray | None,
    tolerance_px: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Polynomial with y = L (x + polynomial(x)), of the lowest order that holds ``tolerance_px`` at the check points.

    Without ``linear`` the linear part becomes L; with it, it stays in the polynomial. All (n, 2), pixels in x.
    """
    for order in range(_LOWEST_ORDER, HIGHEST_ORDER + 1):
        coefficient, matrix = _fitted(x, y, order, linear)
        gap = check_x + _value(coefficient, check_x) - _solved(matrix, check_y)
        residual = float(np.hypot(*gap.T).max())
        if residual < tolerance_px:
            break
    return coefficient, matrix, residual


def _fitted(x: FloatArray, y: FloatArray, order: int, linear: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """(coefficient (order + 1, order + 1, 2), linear part (2, 2)) by least squares, no constant."""
    size = float(np.abs(x).max())
    power = [(p, total - p) for total in range(1, order + 1) for p in range(total, -1, -1)]
    basis = np.stack([(x[:, 0] / size) ** p * (x[:, 1] / size) ** q for p, q in power], axis=1)
    solution = np.asarray(np.linalg.lstsq(basis, y, rcond=None)[0], np.float64)
    matrix = np.asarray(solution[:2].T / size, np.float64) if linear is None else linear
    solution = _solved(matrix, solution)  # in pixels
    solution[:2] = 0.0 if linear is None else solution[:2] - size * np.eye(2)
    solution[np.abs(solution) < _NEGLIGIBLE_PX] = 0.0  # what symmetry forbids, to the rounding error of the fit
    coefficient = np.zeros((order + 1, order + 1, 2))
    for (p, q), value in zip(power, solution, strict=True):
        coefficient[p, q] = value / size ** (p + q)
    return coefficient, matrix


def _value(coefficient: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.polynomial.polyval2d(x[:, 0], x[:, 1], coefficient).T, np.float64)


def _solved(matrix: FloatArray, values: FloatArray) -> FloatArray:
    """Inverse of the matrix (2, 2) times the rows of values (n, 2)."""
    return np.asarray(np.linalg.solve(matrix, values.T).T, np.float64)


def _constant_cards(wcs: LensWcs) -> list[Card]:
    reference = [float(v) for v in pixel_to_fits(*wcs.boresight_px)]
    cards: list[Card] = [
        ("CTYPE1", "RA---TAN-SIP", "gnomonic with SIP distortion"),
        ("CTYPE2", "DEC--TAN-SIP", "gnomonic with SIP distortion"),
        ("CUNIT1", "deg", ""),
        ("CUNIT2", "deg", ""),
        ("CRPIX1", reference[0], "boresight, FITS pixel"),
        ("CRPIX2", reference[1], "boresight, FITS pixel"),
        ("LONPOLE", 180.0, "[deg] north is up at the boresight"),
        ("RADESYS", "ICRS", "axes of the directions as seen"),
        ("WCSWAVE", wcs.wavelength_nm, "[nm] wavelength of the chief rays"),
        ("WCSRESID", wcs.residual_px, "[px] largest distance from traced rays"),
    ]
    for name, table in (("A", wcs.a), ("B", wcs.b), ("AP", wcs.ap), ("BP", wcs.bp)):
        cards.append((f"{name}_ORDER", len(table) - 1, "order of the polynomial"))
        cards += [(f"{name}_{p}_{q}", float(table[p, q]), "") for p, q in np.argwhere(table)]
    return cards


def _dot(a: Any, b: Any) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
