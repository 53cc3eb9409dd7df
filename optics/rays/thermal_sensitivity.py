"""Image changes per kelvin of each component of the temperature field, from traced lenses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.lens.heated_lens import COMPONENTS, DETECTOR, STOP, Housing, ThermalState, heated_lens, with_spacers
from optics.lens.system import AMBIENT, LensSystem
from optics.rays.distortion import plate_scale_mm
from optics.rays.paraxial import axial_paraxial, focus_behind_mm, image_scale_mm
from optics.rays.spots import Spots, trace_spots
from optics.records import freeze, freeze_all
from optics.units import DEG_RAD, RAD_ARCSEC

STEP_K = 2.0
DEGREE = 5
"""Of the polynomial through the shifts over the field."""
QUADRATURE = (6, 16)
COLOUR = (0.85, 1.2)
"""Two wavelengths over that of the design, where none are given."""
LARGEST_STEP_ERROR = 5e-3
"""Difference of derivatives by whole and by double steps, of the largest shift, beyond which there is no derivative."""
ROUNDING_MM = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalSensitivity:
    """Derivatives by the components (5,) of a `ThermalState`, in the order of `COMPONENTS`.

    Shifts are of the centroid of the light on the detector, x along increasing columns, y along increasing rows (so
    that a star which seems to move towards +X of cam has a positive x), in the frame of the detector.
    """

    focal_length_mm: float  # Plate scale at the design wavelength
    field_deg: FloatArray  # (n, 2) Field angles of the traced stars
    shift_mm_per_k: FloatArray  # (5, n, 2)
    focus_um_per_k: FloatArray  # (5,) Paraxial focus of the axis behind the detector, positive: beyond it
    scale_ppm_per_k: FloatArray  # (5,) Growth of the image
    boresight_arcsec_per_k: FloatArray  # (5, 2) Common shift over the focal length, x and y
    roll_arcsec_per_k: FloatArray  # (5,) Turn of the image from +x towards +y
    distortion_arcsec_per_k: FloatArray  # (5,) What is left without shift, scale and roll, RMS over field and axes
    colour_um_per_k: FloatArray  # (5,) Image of the longest less that of the shortest wavelength, RMS over the field
    step_error: FloatArray  # (5,) Largest difference from the derivative by twice the step, of the largest shift
    coefficient: FloatArray  # (5, k, 2) Polynomials in tan(field) / reach [mm/K]
    reach: float  # Tangent of the outermost field along an axis
    fit_error_mm_per_k: FloatArray  # (5,) RMS of the shifts about them

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, field_deg=("n", 2), shift_mm_per_k=(5, "n", 2), sizes=sizes)
        freeze(self, "boresight_arcsec_per_k", shape=(5, 2))
        freeze(self, "coefficient", shape=(5, "k", 2), sizes=sizes)
        for name in (
            "focus_um_per_k",
            "scale_ppm_per_k",
            "roll_arcsec_per_k",
            "distortion_arcsec_per_k",
            "colour_um_per_k",
            "step_error",
            "fit_error_mm_per_k",
        ):
            freeze(self, name, shape=(5,))

    def shift(self, state: ThermalState, direction: ArrayLike) -> FloatArray:
        """Linear prediction of the shift of images on the detector, along columns and rows (..., 2) [mm].

        Stars at directions (..., 3) in cam, within a tenth of the field for which the sensitivity was traced
        (`DomainError`).
        """
        v = np.asarray(direction, float)
        t = v[..., :2] / v[..., 2:]
        if not (np.all(v[..., 2] > 0.0) and np.all(np.abs(t) <= 1.1 * self.reach)):
            raise DomainError(
                "thermal shift: a star is outside the field that was traced, "
                f"{np.degrees(np.arctan(self.reach)):.4g} deg along each axis"
            )
        slopes = np.einsum("c,ckx->kx", state.vector, self.coefficient)
        return np.asarray(_basis(t / self.reach) @ slopes)


def _basis(t: FloatArray) -> FloatArray:
    """Products of powers of x and y (..., k) up to the degree."""
    return np.stack([t[..., 0] ** i * t[..., 1] ** j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], -1)


def thermal_sensitivity(
    lens: LensSystem,
    housing: Housing,
    *,
    corner_deg: float | None = None,
    wavelength_nm: ArrayLike | None = None,
    share: ArrayLike | None = None,
    count: int = 7,
    step_k: float = STEP_K,
) -> ThermalSensitivity:
    """Derivatives of the image with respect to each component of the temperature field, by central differences.

    Parameters
    ----------
    lens : LensSystem
        The lens in its focus of use.
    housing : Housing
        What holds its elements.
    corner_deg : float, optional
        Field angle at the corners of the traced square; that of the lens if left out.
    wavelength_nm : (w,), optional
        Wavelengths [nm], increasing; 0.85, 1 and 1.2 times that of the design within the glasses' range if left out.
    share : (w,), optional
        Light of each; alike if left out.
    count : int
        Stars along a side of the square.
    step_k : float
        Step of the central differences [K].

    Returns
    -------
    ThermalSensitivity
        The derivatives.

    Raises
    ------
    DomainError
        As `heated_lens`; fewer stars than the polynomial needs.
    ConvergenceError
        If a derivative depends on the step by more than 0.5 %.
    """
    if count < DEGREE + 1:
        raise DomainError(f"thermal sensitivity from {count} x {count} stars; at least {DEGREE + 1} along a side")
    waves, light = _light(lens, wavelength_nm, share)
    corner = lens.max_field_deg if corner_deg is None else corner_deg
    reach = float(np.tan(corner * DEG_RAD) / np.sqrt(2.0))
    t = np.stack(np.meshgrid(*(np.linspace(-reach, reach, count),) * 2), -1).reshape(-1, 2)
    angle = np.degrees(np.arctan(t))

    def spots(state: ThermalState) -> Spots:
        return trace_spots(heated_lens(lens, state, housing), angle[:, 0], angle[:, 1], waves, order=QUADRATURE)

    scale = plate_scale_mm(lens)
    white, colour, error = [], [], []
    for unit in np.eye(len(COMPONENTS)):
        steps = step_k * np.array([1.0, -1.0, 2.0, -2.0])
        seen = _images([spots(ThermalState.of(step * unit)) for step in steps], light)
        slope = [
            [(a - b) / (steps[at] - steps[at + 1]) for a, b in zip(*seen[at : at + 2], strict=True)] for at in (0, 2)
        ]
        white.append(slope[0][0])
        colour.append(np.sqrt((slope[0][1] ** 2).sum(-1).mean()))
        size = max(float(np.abs(slope[0][0]).max()), ROUNDING_MM)
        error.append(float(np.abs(slope[0][0] - slope[1][0]).max()) / size)
        if error[-1] > LARGEST_STEP_ERROR and size > ROUNDING_MM:
            raise ConvergenceError(
                f"lens {lens.name!r}: the shift by {COMPONENTS[len(error) - 1]} changes by {100 * error[-1]:.2g} % "
                f"between steps of {step_k:g} and {2 * step_k:g} K; use smaller steps"
            )
    shift = np.stack(white)
    focus = [focus_um_per_k(lens, housing, ThermalState.of(unit)) for unit in np.eye(len(COMPONENTS))]
    return _summarised(t, shift, np.array(colour) * 1e3, np.array(error), np.array(focus), scale, reach)


def _light(lens: LensSystem, wavelength_nm: ArrayLike | None, share: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    low, high = lens.wavelength_range_nm
    design = lens.design_wavelength_nm
    waves = (
        np.clip(np.array([COLOUR[0], 1.0, COLOUR[1]]) * design, low, high) if wavelength_nm is None else wavelength_nm
    )
    waves = np.atleast_1d(np.asarray(waves, float))
    light = np.ones(len(waves)) if share is None else np.asarray(share, float)
    if light.shape != waves.shape or not light.sum() > 0.0 or np.any(np.diff(waves) <= 0.0):
        raise DomainError(f"{waves.size} increasing wavelengths and as many shares of the light are needed")
    return waves, light / light.sum()


def _images(found: Sequence[Spots], light: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Of each: means (n, 2) along columns and rows of all light, and of the longest less the shortest wavelength; rays
    that not all lenses pass are left out."""
    weights = [one.area_mm2 for one in found]
    if len({weight.shape for weight in weights}) == 1:
        passed = np.logical_and.reduce([one.rays.ok for one in found])
        weights = [np.mean(weights, axis=0) * passed] * len(found)
    images = []
    for one, area in zip(found, weights, strict=True):
        total = area.sum(-1)
        if np.any(total <= 0.0):
            raise ConvergenceError("thermal sensitivity: no light arrives at a corner of the field; take a smaller one")
        places = (np.where(one.rays.ok, at, 0.0) for at in (one.rays.x, -one.rays.y))
        mean = np.stack([(at * area).sum(-1) / total for at in places], -1)
        weight = light * total
        white = (mean * (weight / weight.sum(-1, keepdims=True))[..., None]).sum(1)
        images.append((white, mean[:, -1] - mean[:, 0]))
    return images


def _summarised(
    t: FloatArray,
    shift: FloatArray,
    colour_um: FloatArray,
    error: FloatArray,
    focus: FloatArray,
    focal_mm: float,
    reach: float,
) -> ThermalSensitivity:
    """Shift, scale and roll by least squares, what they leave, and polynomials."""
    n, components = len(t), len(shift)
    place = focal_mm * t
    zero, one = np.zeros(n), np.ones(n)
    rows_x = np.stack([one, zero, place[:, 0], -place[:, 1]], -1)
    rows_y = np.stack([zero, one, place[:, 1], place[:, 0]], -1)
    design = np.concatenate([rows_x, rows_y])
    value = np.concatenate([shift[..., 0], shift[..., 1]], 1).T  # (2 n, components)
    similar = np.linalg.lstsq(design, value, rcond=None)[0]
    left = value - design @ similar
    basis = _basis(t / reach)
    coefficient = np.linalg.lstsq(basis, shift.transpose(1, 0, 2).reshape(n, -1), rcond=None)[0]
    coefficient = coefficient.reshape(-1, components, 2).transpose(1, 0, 2)
    fit = np.einsum("nk,ckx->cnx", basis, coefficient)
    return ThermalSensitivity(
        focal_length_mm=focal_mm,
        field_deg=np.degrees(np.arctan(t)),
        shift_mm_per_k=shift,
        focus_um_per_k=focus,
        scale_ppm_per_k=similar[2] * 1e6,
        boresight_arcsec_per_k=similar[:2].T / focal_mm * RAD_ARCSEC,
        roll_arcsec_per_k=similar[3] * RAD_ARCSEC,
        distortion_arcsec_per_k=np.sqrt((left**2).mean(0)) / focal_mm * RAD_ARCSEC,
        colour_um_per_k=colour_um,
        step_error=error,
        coefficient=np.asarray(coefficient, float),
        reach=reach,
        fit_error_mm_per_k=np.sqrt(((shift - fit) ** 2).mean((1, 2))),
    )


def focus_um_per_k(lens: LensSystem, housing: Housing, state: ThermalState, *, step_k: float = STEP_K) -> float:
    """Derivative of the paraxial focus behind the detector along a state of 1 K [um/K]."""
    up, down = (focus_behind_mm(heated_lens(lens, state * (sign * step_k), housing)) for sign in (1.0, -1.0))
    return (up - down) / (2.0 * step_k) * 1e3


def paraxial_change_per_k(cold: LensSystem, warm: LensSystem, step_k: float) -> tuple[float, float]:
    """Growth of the image [1/K] and of the focus behind the detector [um/K], of lenses a step colder and warmer.

    Of paraxial rays alone: no real ray is traced.
    """
    growth = np.log(image_scale_mm(warm) / image_scale_mm(cold)) / (2.0 * step_k)
    return float(growth), (focus_behind_mm(warm) - focus_behind_mm(cold)) / (2.0 * step_k) * 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class Athermal:
    """A spacer that keeps the focus on the detector at every uniform temperature, and the residual."""

    spacer: str  # In front of which element
    length_mm: float  # Its length, between the vertices
    expansion_per_k: float  # It needs
    housing: Housing  # With it
    focus_um_per_k: float  # Left at the temperature of the lens
    focus_um_at_20_k: float  # And 20 K above it
    scale_ppm_per_k: float  # Of the paraxial focal length, with it

    def second_material_mm(self, first_per_k: float, second_per_k: float) -> float:
        """Length of a second material [mm] that gives the first one, filling the rest, this expansion together.

        Beyond the length of the spacer, or negative: the one that expands more has to be longer than the gap, folded
        back as a re-entrant tube.
        """
        if first_per_k == second_per_k:
            raise DomainError(f"two materials of the same expansion {first_per_k:g}/K cannot compensate")
        return self.length_mm * (self.expansion_per_k - first_per_k) / (second_per_k - first_per_k)


def spacers_of(lens: LensSystem) -> tuple[str, ...]:
    """Names of the spacers of a lens that have a length, in the order of the light."""
    names = []
    for i, (before, after) in enumerate(pairwise(lens.poses)):
        behind = lens.surfaces[i + 1] if i + 1 < len(lens.surfaces) else None
        name = DETECTOR if behind is None else behind.element or (STOP if behind.is_stop else "")
        if name and lens.surfaces[i].medium == AMBIENT and np.linalg.norm(after[0] - before[0]) > 0.0:
            names.append(name)
    return tuple(dict.fromkeys(names))


def athermal_spacer(lens: LensSystem, housing: Housing, *, spacer: str = DETECTOR) -> Athermal:
    """Expansion of a spacer that keeps the paraxial focus on the detector.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    housing : Housing
        What holds its elements otherwise.
    spacer : str
        The element behind the spacer, or `DETECTOR`.

    Returns
    -------
    Athermal
        The expansion and what is left.

    Raises
    ------
    DomainError
        If no expansion within +-0.01/K does it.
    """
    uniform = ThermalState(mean_k=1.0)

    def focus(expansion: float) -> float:
        return focus_um_per_k(lens, with_spacers(housing, **{spacer: expansion}), uniform)

    ends = [-0.0099, 0.0099]
    values = [focus(end) for end in ends]
    if not values[0] * values[1] < 0.0:
        raise DomainError(
            f"lens {lens.name!r}: no expansion of the spacer in front of {spacer} within +-0.01/K holds the focus"
        )
    root = float(brentq(focus, *ends, xtol=1e-13))
    made = with_spacers(housing, **{spacer: root})
    heated = [heated_lens(lens, uniform * k, made) for k in (-STEP_K, STEP_K, 20.0)]
    efl = [axial_paraxial(one, one.design_wavelength_nm).efl_mm for one in heated]
    surfaces = enumerate(lens.surfaces)
    place = next((i for i, s in surfaces if spacer in (s.element, STOP if s.is_stop else "")), len(lens.surfaces))
    gap = lens.poses[place][0] - lens.poses[max(place - 1, 0)][0]
    return Athermal(
        spacer=spacer,
        length_mm=float(np.linalg.norm(gap)),
        expansion_per_k=root,
        housing=made,
        focus_um_per_k=focus(root),
        focus_um_at_20_k=(focus_behind_mm(heated[2]) - focus_behind_mm(lens)) * 1e3,
        scale_ppm_per_k=float(np.log(efl[1] / efl[0]) / (2.0 * STEP_K) * 1e6),
    )
