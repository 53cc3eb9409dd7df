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
from optics.field_map import FieldMap, fit_field_map, fit_similarity
from optics.frames import field_direction
from optics.lens.heated_lens import COMPONENTS, DETECTOR, STOP, Housing, ThermalState, heated_lens, with_spacers
from optics.lens.system import AMBIENT, LensSystem
from optics.rays.distortion import plate_scale_mm
from optics.rays.paraxial import axial_paraxial, focus_behind_mm, image_scale_mm
from optics.rays.spots import Spots, trace_spots, weighted_mean
from optics.records import freeze_alike, freeze_all
from optics.units import DEG_RAD, RAD_ARCSEC

STEP_K = 2.0
DEGREE = 5
"""Of the polynomials through the shifts over the field."""
QUADRATURE = (6, 16)
COLOUR = (0.85, 1.2)
"""Two wavelengths over that of the design, where none are given."""
LARGEST_STEP_ERROR = 5e-3
"""Difference of derivatives by single and double steps, of the largest shift, beyond which there is no derivative."""
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
    distortion_arcsec_per_k: FloatArray  # (5,) Residual of shift, scale and roll, RMS over field and axes
    colour_um_per_k: FloatArray  # (5,) Image of the longest less that of the shortest wavelength, RMS over the field
    step_error: FloatArray  # (5,) Largest difference from the derivative by twice the step, of the largest shift
    maps: tuple[FieldMap, ...]  # (5,) Polynomials of the shifts [mm/K]
    fit_error_mm_per_k: FloatArray  # (5,) RMS of the shifts about them

    def __post_init__(self) -> None:
        freeze_all(self, field_deg=("n", 2), shift_mm_per_k=(5, "n", 2), boresight_arcsec_per_k=(5, 2))
        freeze_alike(
            self, "focus_um_per_k", "scale_ppm_per_k", "roll_arcsec_per_k", "distortion_arcsec_per_k",
            "colour_um_per_k", "step_error", "fit_error_mm_per_k", shape=(5,),
        )  # fmt: skip

    def shift(self, state: ThermalState, direction: ArrayLike) -> FloatArray:
        """Linear prediction of the shift of images on the detector, along columns and rows (..., 2) [mm].

        Stars at directions (..., 3) in cam, within a tenth of the field for which the sensitivity was traced
        (`DomainError`).
        """
        v, reach = np.asarray(direction, float), self.maps[0].reach
        if not (np.all(v[..., 2] > 0.0) and np.all(np.abs(v[..., :2] / v[..., 2:]) <= 1.1 * reach)):
            raise DomainError(
                "thermal shift: a star is outside the field that was traced, "
                f"{np.degrees(np.arctan(reach)):.4g} deg along each axis"
            )
        return np.asarray(sum(kelvin * field.at(v) for kelvin, field in zip(state.vector, self.maps, strict=True)))


def thermal_sensitivity(
    lens: LensSystem,
    housing: Housing,
    *,
    corner_deg: float | None = None,
    wavelength_nm: ArrayLike | None = None,
    spectrum: ArrayLike | None = None,
    count: int = 7,
    step_k: float = STEP_K,
) -> ThermalSensitivity:
    """Derivatives of the image with respect to each component of the temperature field, by central differences.

    Parameters
    ----------
    lens : LensSystem
        The lens in its focus of use.
    housing : Housing
        Mechanical support of its elements.
    corner_deg : float, optional
        Field angle at the corners of the traced square; that of the lens if left out.
    wavelength_nm : (w,), optional
        Wavelengths [nm], increasing; 0.85, 1 and 1.2 times that of the design within the glasses' range if left out.
    spectrum : (w,), optional
        Detected photons at each, in any unit; equal if left out.
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
    waves, light = _spectrum(lens, wavelength_nm, spectrum)
    corner = lens.max_field_deg if corner_deg is None else corner_deg
    reach = float(np.tan(corner * DEG_RAD) / np.sqrt(2.0))
    t = np.stack(np.meshgrid(*(np.linspace(-reach, reach, count),) * 2), -1).reshape(-1, 2)
    angle = np.degrees(np.arctan(t))
    states = [ThermalState.of(unit) for unit in np.eye(len(COMPONENTS))]
    shifts, colour, step_error = [], [], []
    for name, state in zip(COMPONENTS, states, strict=True):
        heated = (heated_lens(lens, state * (sign * step_k), housing) for sign in (1.0, -1.0, 2.0, -2.0))
        spots = [trace_spots(changed, angle[:, 0], angle[:, 1], waves, order=QUADRATURE) for changed in heated]
        white, spread = _images(spots, light)
        shift, double = (white[0] - white[1]) / (2.0 * step_k), (white[2] - white[3]) / (4.0 * step_k)
        largest = max(float(np.abs(shift).max()), ROUNDING_MM)
        shifts.append(shift)
        colour.append(np.sqrt((((spread[0] - spread[1]) / (2.0 * step_k)) ** 2).sum(-1).mean()) * 1e3)
        step_error.append(float(np.abs(shift - double).max()) / largest)
        if step_error[-1] > LARGEST_STEP_ERROR and largest > ROUNDING_MM:
            raise ConvergenceError(
                f"lens {lens.name!r}: the shift by {name} changes by {100 * step_error[-1]:.2g} % between steps of "
                f"{step_k:g} and {2 * step_k:g} K; use smaller steps"
            )
    focal_mm = plate_scale_mm(lens)
    motions, residuals = zip(*(fit_similarity(focal_mm * t, shift) for shift in shifts), strict=True)
    motion, direction = np.array(motions), field_direction(*angle.T)
    maps = tuple(fit_field_map(direction, shift, DEGREE) for shift in shifts)
    fit_error = [shift - field.at(direction) for shift, field in zip(shifts, maps, strict=True)]
    return ThermalSensitivity(
        focal_length_mm=focal_mm,
        field_deg=angle,
        shift_mm_per_k=np.array(shifts),
        focus_um_per_k=np.array([focus_um_per_k(lens, housing, state) for state in states]),
        scale_ppm_per_k=motion[:, 3] * 1e6,
        boresight_arcsec_per_k=motion[:, :2] / focal_mm * RAD_ARCSEC,
        roll_arcsec_per_k=motion[:, 2] * RAD_ARCSEC,
        distortion_arcsec_per_k=np.sqrt(np.square(residuals).mean((1, 2))) / focal_mm * RAD_ARCSEC,
        colour_um_per_k=np.array(colour),
        step_error=np.array(step_error),
        maps=maps,
        fit_error_mm_per_k=np.sqrt(np.square(fit_error).mean((1, 2))),
    )


def _spectrum(
    lens: LensSystem, wavelength_nm: ArrayLike | None, spectrum: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """Wavelengths (w,) [nm] and weights (w,) of sum 1."""
    if wavelength_nm is None:
        factors = np.array([COLOUR[0], 1.0, COLOUR[1]])
        wavelength_nm = np.clip(factors * lens.design_wavelength_nm, *lens.wavelength_range_nm)
    waves = np.atleast_1d(np.asarray(wavelength_nm, float))
    light = np.ones(len(waves)) if spectrum is None else np.asarray(spectrum, float)
    if light.shape != waves.shape or not light.sum() > 0.0 or np.any(np.diff(waves) <= 0.0):
        raise DomainError(f"{waves.size} increasing wavelengths and as many values of the spectrum are needed")
    return waves, light / light.sum()


def _images(spots: Sequence[Spots], spectrum: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of each lens: means (s, n, 2) along columns and rows of all light, and of the longest less the shortest
    wavelength; rays that not all lenses pass are left out."""
    areas = [traced.area_mm2 for traced in spots]
    if len({area.shape for area in areas}) == 1:
        passed = np.logical_and.reduce([traced.rays.ok for traced in spots])
        areas = [np.mean(areas, axis=0) * passed] * len(spots)
    white, colour = [], []
    for traced, area in zip(spots, areas, strict=True):
        total = area.sum(-1)
        if np.any(total <= 0.0):
            raise ConvergenceError("thermal sensitivity: no light arrives at a corner of the field; take a smaller one")
        mean = weighted_mean(np.stack([traced.rays.x, -traced.rays.y]), area)  # (2, n, w)
        white.append(weighted_mean(mean, spectrum * total).T)
        colour.append((mean[..., -1] - mean[..., 0]).T)
    return np.array(white), np.array(colour)


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

    spacer: str  # Name of the element behind it
    length_mm: float  # Between the vertices
    expansion_per_k: float  # Required of the spacer
    housing: Housing  # With this spacer
    focus_um_per_k: float  # Residual at the temperature of the lens
    focus_um_at_20_k: float  # Residual 20 K above it
    scale_ppm_per_k: float  # Of the paraxial focal length

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
        Mechanical support of the other elements.
    spacer : str
        The element behind the spacer, or `DETECTOR`.

    Returns
    -------
    Athermal
        The expansion, and the residual focus and scale.

    Raises
    ------
    DomainError
        If no expansion within +-0.01/K does it.
    """
    uniform = ThermalState(mean_k=1.0)

    def focus(expansion: float) -> float:
        return focus_um_per_k(lens, with_spacers(housing, **{spacer: expansion}), uniform)

    ends = (-0.0099, 0.0099)
    if not focus(ends[0]) * focus(ends[1]) < 0.0:
        raise DomainError(
            f"lens {lens.name!r}: no expansion of the spacer in front of {spacer} within +-0.01/K holds the focus"
        )
    root = float(brentq(focus, *ends, xtol=1e-13))
    athermal = with_spacers(housing, **{spacer: root})
    cold, warm, hot = (heated_lens(lens, uniform * kelvin, athermal) for kelvin in (-STEP_K, STEP_K, 20.0))
    cold_efl, warm_efl = (axial_paraxial(state, state.design_wavelength_nm).efl_mm for state in (cold, warm))
    behind = [spacer in (s.element, STOP if s.is_stop else "") for s in lens.surfaces]
    end = behind.index(True) if any(behind) else len(lens.surfaces)
    gap = lens.poses[end][0] - lens.poses[max(end - 1, 0)][0]
    return Athermal(
        spacer=spacer,
        length_mm=float(np.linalg.norm(gap)),
        expansion_per_k=root,
        housing=athermal,
        focus_um_per_k=focus(root),
        focus_um_at_20_k=(focus_behind_mm(hot) - focus_behind_mm(lens)) * 1e3,
        scale_ppm_per_k=float(np.log(warm_efl / cold_efl) / (2.0 * STEP_K) * 1e6),
    )
