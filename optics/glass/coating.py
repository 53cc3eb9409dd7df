r"""Coatings: reflectance and transmittance of a surface for s and p light, over wavelength and angle of incidence.

A stack of thin films between two media (characteristic matrices; Macleod, *Thin-Film Optical Filters*, 4th ed.,
sec. 2.6, with :math:`n - ik` and :math:`\delta_j = 2 \pi n_j d_j \cos\theta_j / \lambda`):

.. math::

   \begin{pmatrix} B \\ C \end{pmatrix} = \prod_j \begin{pmatrix} \cos\delta_j & i \sin\delta_j / \eta_j \\
   i \eta_j \sin\delta_j & \cos\delta_j \end{pmatrix} \begin{pmatrix} 1 \\ \eta_m \end{pmatrix}, \quad
   R = \left| \frac{\eta_0 B - C}{\eta_0 B + C} \right|^2, \quad
   T = \frac{4 \eta_0 \mathrm{Re}\,\eta_m}{|\eta_0 B + C|^2}

with admittances :math:`\eta = n \cos\theta` (s) and :math:`n / \cos\theta` (p). Light neither reflected nor transmitted
is absorbed in the films. Evaporated films have the bulk indices here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.glass.catalogue import Glass, get_glass
from optics.interpolation import bracket
from optics.records import freeze
from optics.response import checked_wavelength

ROUNDING = 1e-12
"""By which R + T of a table may exceed 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Split:
    """Reflectance and transmittance of a surface for s and p light; arrays of one shape."""

    reflectance_s: FloatArray
    reflectance_p: FloatArray
    transmittance_s: FloatArray
    transmittance_p: FloatArray

    @property
    def reflectance(self) -> FloatArray:
        """Reflectance for unpolarised light."""
        return 0.5 * (self.reflectance_s + self.reflectance_p)

    @property
    def transmittance(self) -> FloatArray:
        """Transmittance for unpolarised light."""
        return 0.5 * (self.transmittance_s + self.transmittance_p)


class Coating(ABC):
    """Interface of coatings."""

    @abstractmethod
    def split(
        self, wavelength_nm: ArrayLike, n_before: ArrayLike, n_after: ArrayLike, cos_incidence: ArrayLike = 1.0
    ) -> Split:
        """Reflectance and transmittance; arrays that broadcast. Indices are relative to the surroundings.

        Raises
        ------
        DomainError
            Wavelength outside the range of a material or table.
        """

    def reflectance(self, wavelength_nm: ArrayLike, index: ArrayLike) -> FloatArray:
        """Residual reflectance at normal incidence on glass of that index, in air."""
        return self.split(wavelength_nm, 1.0, index).reflectance


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """One film of a stack.

    Attributes
    ----------
    thickness_nm : float
        Geometric thickness.
    material : Glass or None
        Material, whose index follows the wavelength; else ``index``.
    index : float
        Index of a film without a material.
    extinction : float
        Imaginary part k of its index; 0: the film absorbs nothing.
    """

    thickness_nm: float
    material: Glass | None = None
    index: float = 0.0
    extinction: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.thickness_nm < np.inf:
            raise DomainError(f"film: thickness_nm = {self.thickness_nm:g} nm; it must be positive")
        if not 0.0 <= self.extinction < np.inf:
            raise DomainError(f"film: extinction = {self.extinction:g}; it must not be negative")
        if (self.material is None) == (self.index == 0.0):
            raise ConfigError("a film needs either a material or an index")
        if not 0.0 <= self.index < np.inf:
            raise DomainError(f"film: index = {self.index:g}; it must be positive")

    def complex_index(self, wavelength_nm: FloatArray) -> FloatArray:
        """Index n - ik."""
        real = self.index if self.material is None else self.material.index(wavelength_nm)
        return np.asarray(real - 1j * self.extinction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stack(Coating):
    """Stack of thin films; empty: a bare surface.

    Attributes
    ----------
    films : tuple of Film
        Listed from the side of the lower index, that of the air.
    """

    films: tuple[Film, ...] = ()

    def split(
        self, wavelength_nm: ArrayLike, n_before: ArrayLike, n_after: ArrayLike, cos_incidence: ArrayLike = 1.0
    ) -> Split:
        wave, first, last = (np.asarray(v, dtype=np.float64) for v in (wavelength_nm, n_before, n_after))
        sine2 = first**2 * (1.0 - np.minimum(np.asarray(cos_incidence, dtype=np.float64), 1.0) ** 2)
        films = self.films if np.mean(first) <= np.mean(last) else self.films[::-1]
        layers = [(film.complex_index(wave), film.thickness_nm) for film in films]
        (rs, ts), (rp, tp) = (_matrix_product(wave, layers, first, last, sine2, p) for p in (False, True))
        return Split(reflectance_s=rs, reflectance_p=rp, transmittance_s=ts, transmittance_p=tp)


def _matrix_product(
    wave: FloatArray, layers: list[tuple[FloatArray, float]], first: FloatArray, last: FloatArray, sine2: FloatArray,
    p: bool,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """R and T of one polarisation; ``sine2`` is (n sin)^2, the same in all layers."""

    def along(index: FloatArray) -> FloatArray:
        """Index times cosine, waves that fade with depth where the angle is beyond the critical one."""
        root = np.sqrt(np.asarray(index, dtype=np.complex128) ** 2 - sine2)
        return np.asarray(np.where(root.imag > 0.0, -root, root))

    def admittance(index: FloatArray, normal: FloatArray) -> FloatArray:
        return np.asarray(index**2 / normal if p else normal)

    normal = along(last + 0.0 * wave)
    eta_m = admittance(last, normal)
    b: Any = np.ones_like(normal)
    c: Any = eta_m
    for index, thickness in reversed(layers):
        normal = along(index)
        delta, eta = 2.0 * np.pi * thickness * normal / wave, admittance(index, normal)
        cosine, sine = np.cos(delta), 1j * np.sin(delta)
        b, c = cosine * b + sine / eta * c, eta * sine * b + cosine * c
    eta_0 = admittance(first, along(first)).real
    denominator = np.abs(eta_0 * b + c) ** 2
    reflectance = np.abs(eta_0 * b - c) ** 2 / denominator
    return np.asarray(reflectance), np.asarray(4.0 * eta_0 * eta_m.real / denominator)


BARE = Stack()
"""Bare glass."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QuarterWave(Coating):
    """One film, a quarter of the design wavelength thick; magnesium fluoride unless another material is given.

    Attributes
    ----------
    design_wavelength_nm : float
        Wavelength of least reflectance [nm].
    film : Glass
        Material of the film.

    Raises
    ------
    DomainError
        Design wavelength outside the range of the material.
    """

    design_wavelength_nm: float = 550.0
    film: Glass = field(default_factory=lambda: get_glass("MgF2"))

    def __post_init__(self) -> None:
        self.film.index(self.design_wavelength_nm)

    @property
    def stack(self) -> Stack:
        """The film with its thickness."""
        thickness = 0.25 * self.design_wavelength_nm / float(self.film.index(self.design_wavelength_nm))
        return Stack(films=(Film(thickness_nm=thickness, material=self.film),))

    def split(
        self, wavelength_nm: ArrayLike, n_before: ArrayLike, n_after: ArrayLike, cos_incidence: ArrayLike = 1.0
    ) -> Split:
        return self.stack.split(wavelength_nm, n_before, n_after, cos_incidence)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TabulatedCoating(Coating):
    """Tabulated reflectance, independent of the glass and of the side.

    Linear between the entries. Angles are those in the medium of lower index; beyond the last one its values hold,
    beyond the critical angle all light is reflected.

    Attributes
    ----------
    source : str
        Where the numbers come from.
    wavelength_nm : (w,)
        Increasing wavelengths.
    angle_deg : (a,)
        Increasing angles of incidence; one alone: values for all angles.
    reflectance_s, reflectance_p : (a, w)
        Fractions of s and p light.
    transmittance_s, transmittance_p : (a, w), optional
        Left out: all light that is not reflected.

    Raises
    ------
    DomainError
        Wavelengths or angles that do not increase, a negative fraction, R + T above 1.
    """

    source: str
    wavelength_nm: FloatArray
    reflectance_s: FloatArray
    reflectance_p: FloatArray
    angle_deg: FloatArray = field(default_factory=lambda: np.zeros(1))
    transmittance_s: FloatArray | None = None
    transmittance_p: FloatArray | None = None

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        wave = freeze(self, "wavelength_nm", shape=("w",), sizes=sizes)
        angle = freeze(self, "angle_deg", shape=("a",), sizes=sizes)
        if not self.source:
            raise ConfigError("a coating's table needs a source; say where its numbers come from")
        if len(wave) < 2 or not (wave[0] > 0.0 and (np.diff(wave) > 0.0).all()):
            raise DomainError("coating: at least two wavelengths [nm] are needed, positive and increasing")
        if not len(angle) or not (angle[0] >= 0.0 and angle[-1] <= 90.0 and (np.diff(angle) > 0.0).all()):
            raise DomainError("coating: angles of incidence must increase, from 0 to at most 90 deg")
        for of in "sp":
            reflected = freeze(self, f"reflectance_{of}", shape=("a", "w"), sizes=sizes)
            if getattr(self, f"transmittance_{of}") is None:
                object.__setattr__(self, f"transmittance_{of}", 1.0 - reflected)
            passed = freeze(self, f"transmittance_{of}", shape=("a", "w"), sizes=sizes)
            for name, bad, value in (
                ("R", reflected < 0.0, reflected),
                ("R", reflected > 1.0, reflected),
                ("T", passed < 0.0, passed),
                ("R + T", reflected + passed > 1.0 + ROUNDING, reflected + passed),
            ):
                if bad.any():
                    at = tuple(np.argwhere(bad)[0])
                    raise DomainError(
                        f"coating ({self.source}): {name} = {value[at]:g} for {of} light at {wave[at[1]]:g} nm, "
                        f"{angle[at[0]]:g} deg; R and T must be 0 ... 1, and R + T at most 1"
                    )

    def split(
        self, wavelength_nm: ArrayLike, n_before: ArrayLike, n_after: ArrayLike, cos_incidence: ArrayLike = 1.0
    ) -> Split:
        ends = (float(self.wavelength_nm[0]), float(self.wavelength_nm[-1]))
        wave = checked_wavelength(wavelength_nm, ends, f"coating ({self.source})", "the table ends there")
        first, last, cosine = (np.asarray(v, dtype=np.float64) for v in (n_before, n_after, cos_incidence))
        inside = first * np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
        angle = np.degrees(np.arcsin(np.minimum(inside / np.minimum(first, last), 1.0)))
        wave, angle, total = np.broadcast_arrays(wave, angle, inside > last)
        rows, columns = bracket(self.angle_deg, angle), bracket(self.wavelength_nm, wave)

        def at(table: FloatArray | None, beyond: float) -> FloatArray:
            assert table is not None
            inside = sum(weight * sum(part * table[row, column] for column, part in columns) for row, weight in rows)
            return np.asarray(np.where(total, beyond, inside))

        return Split(
            reflectance_s=at(self.reflectance_s, 1.0),
            reflectance_p=at(self.reflectance_p, 1.0),
            transmittance_s=at(self.transmittance_s, 0.0),
            transmittance_p=at(self.transmittance_p, 0.0),
        )
