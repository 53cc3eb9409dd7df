r"""Dispersion formulas of glass catalogues in one common form for any array library.

Every published formula is a sum of powers of the wavelength and of resonances, for the index or its square:

.. math:: F(n) = c_0 + \sum_j a_j \lambda^{p_j} + \sum_k \frac{b_k \lambda^{q_k}}{(\lambda^2 - L_k)^{m_k}}, \quad
          F(n) = n^2 \text{ or } n, \quad \lambda \text{ in um}

The exponents are the structure (`Form`, hashable), the coefficients are numbers that perturbations may change.
`FORMULAS` contains the thirteen formulas of AGF catalogues (Zemax OpticStudio Help, *Glass dispersion formulas*) and
formulas 1 to 7 of refractiveindex.info (M. Polyanskiy, Sci. Data 11, 94 (2024)) by name, coefficients in the published
order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import NUMPY, ArrayNamespace, FloatArray
from optics.errors import ConfigError, DomainError, unknown_name

LARGEST_EXPONENT = 24
"""Largest power of the wavelength, computed as a product; published formulas go to 12."""

_Numbers = Sequence[float]


@dataclass(frozen=True, slots=True)
class Form:
    """Structure of a dispersion formula; its numbers are ordered as factors of the powers, strengths, resonances."""

    squared: bool  # Whether the sum is n^2 (else n)
    constant: float = 0.0  # First term of the sum
    powers: tuple[float, ...] = ()  # Exponents of the wavelength; whole or half
    # (int, int) For each resonance the exponent of the wavelength in its numerator and the order of the pole
    poles: tuple[tuple[int, int], ...] = ()

    @property
    def size(self) -> int:
        """Number of its coefficients."""
        return len(self.powers) + 2 * len(self.poles)

    def total(self, wavelength_nm: Any, numbers: Sequence[Any], xp: ArrayNamespace) -> Any:
        """The sum, on any array type with arithmetic; numbers as in `Dispersion.numbers`."""
        wave = wavelength_nm * 1e-3
        l2 = wave * wave
        first, second = len(self.powers), len(self.powers) + len(self.poles)
        n2: Any = self.constant
        for factor, exponent in zip(numbers[:first], self.powers, strict=True):
            n2 = n2 + (factor if exponent == 0 else factor * _power(wave, l2, exponent, xp))
        strengths, resonances = numbers[first:second], numbers[second : second + len(self.poles)]
        for strength, resonance, (exponent, order) in zip(strengths, resonances, self.poles, strict=True):
            if (exponent, order) == (2, 1):
                n2 = n2 + strength * l2 / (l2 - resonance)
            else:
                top = strength if exponent == 0 else strength * _power(wave, l2, exponent, xp)
                bottom = l2 - resonance
                n2 = n2 + top / (bottom if order == 1 else bottom * bottom)
        return n2

    def index(self, wavelength_nm: Any, numbers: Sequence[Any], xp: ArrayNamespace) -> Any:
        """Index at each wavelength [nm], type and shape of ``wavelength_nm``."""
        total = self.total(wavelength_nm, numbers, xp)
        return xp.sqrt(total) if self.squared else total


def _power(wave: Any, l2: Any, exponent: float, xp: ArrayNamespace) -> Any:
    """A whole or half power of the wavelength, by products and one root."""
    pairs, rest = divmod(abs(exponent), 2)
    value: Any = None
    for factor in [l2] * int(pairs) + [wave] * (rest >= 1) + [xp.sqrt(wave)] * (rest % 1 == 0.5):
        value = factor if value is None else value * factor
    return value if exponent > 0 else 1.0 / value


@dataclass(frozen=True, slots=True)
class Dispersion:
    """A formula with its coefficients."""

    formula: str  # One of `FORMULAS`
    coefficients: tuple[float, ...]  # In the published order; wavelengths in um

    def __post_init__(self) -> None:
        if self.formula not in FORMULAS:
            raise unknown_name("dispersion formula", self.formula, FORMULAS)
        object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))
        if not np.isfinite(self.coefficients).all():
            raise DomainError(f"dispersion coefficients {self.coefficients} hold a value that is not finite")
        try:
            form, numbers = FORMULAS[self.formula](self.coefficients)
            if not np.isfinite(np.asarray(numbers, float)).all():  # TypeError: a root of a negative number
                raise ValueError
            if any(abs(p) > LARGEST_EXPONENT for p in (*form.powers, *(p for p, _ in form.poles))):
                raise ValueError
        except (IndexError, OverflowError, TypeError, ValueError, ZeroDivisionError):
            raise ConfigError(
                f"dispersion formula {self.formula!r} cannot have the {len(self.coefficients)} coefficients "
                f"{str(self.coefficients)[:200]}"
            ) from None

    @staticmethod
    def sellmeier(B: Sequence[float], C: Sequence[float]) -> Dispersion:
        """Sellmeier's formula: strengths, and squared resonance wavelengths [um^2]."""
        if not B or len(B) != len(C):
            raise DomainError(f"{len(B)} B and {len(C)} C; both need one value per term")
        return Dispersion("sellmeier", tuple(x for pair in zip(B, C, strict=True) for x in pair))

    @staticmethod
    def constant(index: float) -> Dispersion:
        """The same index at every wavelength."""
        return Dispersion("polynomial", (index, 0.0))

    @property
    def form(self) -> Form:
        """Structure of the formula, without its numbers."""
        return FORMULAS[self.formula](self.coefficients)[0]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Numbers in the order of `Form`."""
        return FORMULAS[self.formula](self.coefficients)[1]

    @property
    def resonances_um2(self) -> tuple[float, ...]:
        """Squared wavelengths at which it has a pole [um^2]."""
        return self.numbers[len(self.numbers) - len(self.form.poles) :]

    def total(self, wavelength_nm: ArrayLike) -> FloatArray:
        """The sum of `Form` on NumPy arrays: n^2 or n."""
        wave = np.asarray(wavelength_nm, dtype=np.float64)
        return np.asarray(self.form.total(wave, self.numbers, NUMPY) + np.zeros_like(wave))

    def index(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Index on NumPy arrays; wavelengths in nm."""
        total = self.total(wavelength_nm)
        return np.sqrt(total) if self.form.squared else total


_Parsed = tuple[Form, tuple[float, ...]]


def _sum(squared: bool, exponents: Sequence[float]) -> Callable[[_Numbers], _Parsed]:
    """Powers only; catalogues may leave out trailing coefficients."""

    def parse(c: _Numbers) -> _Parsed:
        if not 0 < len(c) <= len(exponents):
            raise ValueError
        used = [(p, x) for p, x in zip(exponents, c, strict=False) if x != 0.0] or [(0.0, 0.0)]
        return Form(squared, 0.0, tuple(p for p, _ in used)), tuple(x for _, x in used)

    return parse


def _resonances(constant: bool) -> Callable[[_Numbers], _Parsed]:
    """n^2 = 1 + [A] + sum B l^2 / (l^2 - C)."""

    def parse(c: _Numbers) -> _Parsed:
        lead, pairs = (c[:1], c[1:]) if constant else ((), c)
        if len(pairs) % 2 or not c:
            raise ValueError
        terms = [(b, r) for b, r in zip(pairs[::2], pairs[1::2], strict=True)]
        form = Form(True, 1.0, (0.0,) * len(lead), ((2, 1),) * len(terms))
        return form, (*lead, *(b for b, _ in terms), *(r for _, r in terms))

    return parse


def _herzberger(c: _Numbers) -> _Parsed:
    a, b, c2, *rest = c
    exponents = tuple(2.0 * (i + 1) for i in range(len(rest)))
    return Form(False, 0.0, (0.0, *exponents), ((0, 1), (0, 2))), (a, *rest, b, c2, 0.028, 0.028)


def _sellmeier2(c: _Numbers) -> _Parsed:
    a, b1, l1, b2, l2 = c
    return Form(True, 1.0, (0.0,), ((2, 1), (0, 1))), (a, b1, b2, l1 * l1, l2 * l2)


def _handbook(exponent: int) -> Callable[[_Numbers], _Parsed]:
    def parse(c: _Numbers) -> _Parsed:
        a, b, c2, d = c
        return Form(True, 0.0, (0.0, 2.0), ((exponent, 1),)), (a, -d, b, c2)

    return parse


def _sellmeier4(c: _Numbers) -> _Parsed:
    a, b, c2, d, e = c
    return Form(True, 0.0, (0.0,), ((2, 1), (2, 1))), (a, b, d, c2, e)


def _polynomial(squared: bool) -> Callable[[_Numbers], _Parsed]:
    """F(n) = C1 + C2 l^C3 + C4 l^C5 + ...; refractiveindex.info 3 (squared) and 5."""

    def parse(c: _Numbers) -> _Parsed:
        if not squared and len(c) == 2 and c[1] == 0.0:
            c = c[:1]
        if len(c) % 2 == 0 or any((2 * p) % 1 for p in c[2::2]):
            raise ValueError
        return Form(squared, 0.0, (0.0, *c[2::2])), (c[0], *c[1::2])

    return parse


def _mixed(c: _Numbers) -> _Parsed:
    """n^2 = C1 + C2 l^C3 / (l^2 - C4^C5) + C6 l^C7 / (l^2 - C8^C9) + C10 l^C11 + ...; refractiveindex.info 4."""
    padded = [*c, *[0.0] * max(0, 9 - len(c))]
    poles = [padded[1:5], padded[5:9]]
    pairs = list(zip(padded[9::2], padded[10::2], strict=True))
    if any(p % 1 for _, p, _, _ in poles) or any((2 * p) % 1 for _, p in pairs):
        raise ValueError
    resonances = [(b, int(p), base**e) for b, p, base, e in poles if b != 0.0]
    form = Form(True, 0.0, (0.0, *(p for _, p in pairs)), tuple((p, 1) for _, p, _ in resonances))
    return form, (padded[0], *(a for a, _ in pairs), *(b for b, _, _ in resonances), *(r for _, _, r in resonances))


def _gas(c: _Numbers) -> _Parsed:
    """n - 1 = C1 + sum C2 / (C3 - l^-2) = C1 + sum (C2 / C3) l^2 / (l^2 - 1 / C3); refractiveindex.info 6."""
    if len(c) % 2 == 0:
        raise ValueError
    pairs = list(zip(c[1::2], c[2::2], strict=True))
    form = Form(False, 1.0, (0.0,), ((2, 1),) * len(pairs))
    return form, (c[0], *(b / r for b, r in pairs), *(1.0 / r for _, r in pairs))


FORMULAS: dict[str, Callable[[_Numbers], _Parsed]] = {
    "schott": _sum(True, (0, 2, -2, -4, -6, -8)),
    "sellmeier": _resonances(constant=False),
    "herzberger": _herzberger,
    "sellmeier2": _sellmeier2,
    "conrady": _sum(False, (0, -1, -3.5)),
    "handbook1": _handbook(0),
    "handbook2": _handbook(2),
    "sellmeier4": _sellmeier4,
    "extended": _sum(True, (0, 2, -2, -4, -6, -8, -10, -12)),
    "extended2": _sum(True, (0, 2, -2, -4, -6, -8, 4, 6)),
    "extended3": _sum(True, (0, 2, 4, -2, -4, -6, -8, -10, -12)),
    "shifted_sellmeier": _resonances(constant=True),
    "square_polynomial": _polynomial(squared=True),
    "polynomial": _polynomial(squared=False),
    "mixed": _mixed,
    "gas": _gas,
}
"""How every formula reads its coefficients. ``sellmeier`` takes any number of pairs B1, C1, B2, C2, ... ."""

AGF_FORMULAS: dict[int, tuple[str, int]] = {
    1: ("schott", 6),
    2: ("sellmeier", 6),
    3: ("herzberger", 6),
    4: ("sellmeier2", 5),
    5: ("conrady", 3),
    6: ("sellmeier", 8),
    7: ("handbook1", 4),
    8: ("handbook2", 4),
    9: ("sellmeier4", 5),
    10: ("extended", 8),
    11: ("sellmeier", 10),
    12: ("extended2", 8),
    13: ("extended3", 9),
}
"""Number of a formula in AGF catalogues: its name here, and its number of coefficients."""
