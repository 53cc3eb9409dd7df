"""The PSF over the field and against colour: three Gaussians integrated over pixels, at fixed positions.

A star at its calibrated catalogue position cannot move, so that wings and core are determined. The core and the halo
are round and of the same width everywhere; the widths of the middle part change over the field (linear and quadratic)
and between colour classes, and so does the share of the core. Flux and background of every star are eliminated (they
are linear), the remaining parameters are common to all frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.records import freeze
from render.records import EffectivePsf

COLOUR_EDGES_K = (4500.0, 5500.0, 7000.0)
COLOUR_NAMES = ("below 4500 K", "4500 to 5500 K", "5500 to 7000 K", "above 7000 K")
REFERENCE_CLASS = 1
FEWEST_STARS = 25
FEWEST_OF_A_CLASS = 6
MODEL_FRACTION = 0.02
"""Of the light of a star in a pixel: what three Gaussians cannot describe, so that bright stars do not rule."""
WIDEST_HALO = 0.25
"""Width of the halo over the side of the window: of a wider one most light would be anybody's guess."""
CLIP = 8.0
ROUNDS = 3
COUNT = 18


def colour_class(temperature_k: FloatArray) -> IntArray:
    """Class (n,) of stars by their colour temperature."""
    return np.digitize(temperature_k, COLOUR_EDGES_K).astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class StarSample:
    """Windows around stars whose place is known."""

    dn: FloatArray  # (n, s, s) Pixels, less the background that the frame has there
    offset_px: FloatArray  # (n, 2) Place of the star from the middle pixel, column and row
    place_px: FloatArray  # (n, 2) On the detector
    colour: IntArray  # (n,) `colour_class`
    frame: IntArray  # (n,)
    star: IntArray  # (n,) Row of the stars of its frame
    level_dn: FloatArray  # (n,) That background
    valid: NDArray[np.bool_]  # (n, s, s)

    def __len__(self) -> int:
        return len(self.dn)

    def select(self, rows: NDArray[np.bool_]) -> StarSample:
        """Sample of some of the stars."""
        return StarSample(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfModel:
    """Three Gaussians over a detector; parameters and their covariance."""

    size_px: tuple[int, int]  # Columns and rows of the detector
    # (18,) Logarithms of the shares of core and halo over that of the middle part, of the widths [px] of core, middle
    # (x, y) and halo; changes of the middle's logarithms over the field (x by r^2, y by r^2, x by x, x by y, y by x,
    # y by y) and with the three colour classes that are not the reference; changes of the core's logarithm with them
    value: FloatArray
    covariance: FloatArray  # (18, 18) Scaled by the misfit; infinite where nothing was determined
    chi2: float  # Per degree of freedom
    stars: int

    def __post_init__(self) -> None:
        freeze(self, "value", shape=(COUNT,))
        freeze(self, "covariance", shape=(COUNT, COUNT), finite=False)

    def parts(self, place_px: FloatArray, colour: IntArray) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Shares and widths (n,) along x and y [px] of the three Gaussians."""
        v, one = self.value, np.ones(len(place_px))
        u = (place_px - (np.asarray(self.size_px) - 1.0) / 2.0) / (0.5 * float(np.hypot(*self.size_px)))
        r2 = (u**2).sum(axis=1)
        by_colour = np.insert(v[12:15], REFERENCE_CLASS, 0.0)[colour]
        along_x = np.exp(v[3] + by_colour + v[6] * r2 + v[8] * u[:, 0] + v[9] * u[:, 1])
        along_y = np.exp(v[4] + by_colour + v[7] * r2 + v[10] * u[:, 0] + v[11] * u[:, 1])
        core, halo = np.exp(v[2]) * one, np.exp(v[5]) * one
        inner, outer = np.exp(v[0] + np.insert(v[15:18], REFERENCE_CLASS, 0.0)[colour]), np.exp(v[1])
        whole = 1.0 + inner + outer
        return (inner / whole, core, core), (1.0 / whole, along_x, along_y), (outer / whole, halo, halo)

    def draw(self, offset_px: FloatArray, place_px: FloatArray, colour: IntArray, size: int) -> FloatArray:
        """Share of the light in each pixel (n, size, size) of windows about stars."""
        edge = np.arange(size + 1) - size / 2.0
        out = np.zeros((len(offset_px), size, size))
        for share, along_x, along_y in self.parts(place_px, colour):
            x = np.diff(ndtr((edge - offset_px[:, :1]) / along_x[:, None]), axis=1)
            y = np.diff(ndtr((edge - offset_px[:, 1:]) / along_y[:, None]), axis=1)
            out += share[:, None, None] * y[:, :, None] * x[:, None, :]
        return out

    def effective(self, place_px: FloatArray, colour: int, *, half_px: int = 6, oversampling: int = 4) -> EffectivePsf:
        """The PSF at a place (2,) of a colour class, sampled finer than pixels."""
        at = np.arange(-half_px * oversampling, half_px * oversampling + 1) / oversampling
        values = np.zeros((len(at), len(at)))
        for share, along_x, along_y in self.parts(np.reshape(place_px, (1, 2)), np.array([colour])):
            x, y = (ndtr((at + 0.5) / s[0]) - ndtr((at - 0.5) / s[0]) for s in (along_x, along_y))
            values += share[0] * y[:, None] * x[None, :]
        return EffectivePsf(values=values, oversampling=oversampling)

    @property
    def flux_error(self) -> float:
        """Relative error, common to all stars, of a flux by this shape: its parameters are uncertain."""
        middle = (np.asarray(self.size_px, float)[None] - 1.0) / 2.0

        def drawn(value: FloatArray) -> FloatArray:
            return replace(self, value=value).draw(np.zeros((1, 2)), middle, np.array([REFERENCE_CLASS]), 9).ravel()

        free = np.flatnonzero(np.diag(self.covariance) > 0.0)
        step, shape = 1e-3, drawn(self.value)
        slope = [(drawn(self.value + step * np.eye(COUNT)[k]) - shape) @ shape / step for k in free] / (shape @ shape)
        return float(np.sqrt(slope @ self.covariance[np.ix_(free, free)] @ slope))

    def width_px(self, place_px: FloatArray, colour: IntArray) -> FloatArray:
        """Width (n,) of the middle part, mean of both axes."""
        _, (_, along_x, along_y), _ = self.parts(place_px, colour)
        return np.asarray((along_x + along_y) / 2.0)


def linear_fit(model: FloatArray, dn: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Flux, background and variance of the flux (n,) of stars of a given shape; all arguments (n, s, s)."""
    shape, values, w = (one.reshape(len(one), -1) for one in (model, dn, weight))
    a, b, c = (w * shape**2).sum(1), (w * shape).sum(1), w.sum(1)
    u, v = (w * shape * values).sum(1), (w * values).sum(1)
    determinant = np.maximum(a * c - b * b, 1e-300)
    return (c * u - b * v) / determinant, (a * v - b * u) / determinant, c / determinant


def fit_psf(
    sample: StarSample,
    size_px: tuple[int, int],
    *,
    noise_dn2: tuple[float, float],
    width_px: float,
    start: FloatArray | None = None,
) -> PsfModel:
    """Shape from isolated, unsaturated stars at known places; ``noise_dn2`` is a pixel's variance, constant and per DN.

    The search begins at ``start`` (18,), or at the typical width of a Gaussian fit.
    """
    if len(sample) < FEWEST_STARS:
        raise DomainError(
            f"{len(sample)} bright, isolated, unsaturated stars in all frames; the PSF needs {FEWEST_STARS}: more "
            "frames, or a longer exposure"
        )
    size = sample.dn.shape[1]
    count = np.bincount(sample.colour, minlength=4)
    freed = np.ones(COUNT, bool)
    freed[12:15] = [n >= FEWEST_OF_A_CLASS for k, n in enumerate(count) if k != REFERENCE_CLASS]
    freed[15:18] = freed[12:15]
    freed[6:12] = len(sample) >= 4 * FEWEST_STARS
    value = np.zeros(COUNT)
    value[:6] = [-2.0, -2.0, np.log(0.4 * width_px), np.log(width_px), np.log(width_px), np.log(3.2 * width_px)]
    if start is not None:
        value[freed] = start[freed]
    low = np.array(
        [-5, -5, np.log(0.05), np.log(0.1), np.log(0.1), np.log(1.5 * width_px), *[-1.5] * 6, *[-0.7] * 3, *[-1.5] * 3]
    )
    high = np.array(
        [
            *[4.0] * 2,
            np.log(0.8 * width_px),
            *[np.log(6.0)] * 2,
            np.log(max(WIDEST_HALO * size, 1.6 * width_px)),
            *[1.5] * 6,
            *[0.7] * 3,
            *[0.9] * 3,
        ]
    )
    prior = np.array([*[np.inf] * 6, *[0.5] * 6, *[0.2] * 3, *[0.5] * 3])[freed]  # of changes: few stars tell little
    model = PsfModel(
        size_px=size_px, value=value, covariance=np.full((COUNT, COUNT), np.inf), chi2=float("nan"), stars=len(sample)
    )
    sky = noise_dn2[0] + noise_dn2[1] * np.maximum(sample.level_dn, 1.0)[:, None, None]
    weight = np.where(sample.valid, 1.0 / sky, 0.0)

    def drawn(at: FloatArray) -> FloatArray:
        whole = value.copy()
        whole[freed] = at
        return replace(model, value=whole).draw(sample.offset_px, sample.place_px, sample.colour, size)

    def misfit(at: FloatArray) -> FloatArray:
        shape = drawn(at)
        flux, level, _ = linear_fit(shape, sample.dn, weight)
        left = sample.dn - flux[:, None, None] * shape - level[:, None, None]
        return np.concatenate([np.clip(left * np.sqrt(weight), -CLIP, CLIP).ravel(), at / prior])

    for _ in range(ROUNDS if start is None else 1):
        shape = drawn(value[freed])
        flux, _, _ = linear_fit(shape, sample.dn, weight)
        light = np.maximum(flux, 0.0)[:, None, None] * shape
        weight = np.where(sample.valid, 1.0 / (sky + noise_dn2[1] * light + (MODEL_FRACTION * light) ** 2), 0.0)
        start = np.clip(value[freed], low[freed] + 1e-6, high[freed] - 1e-6)
        found = least_squares(misfit, start, bounds=(low[freed], high[freed]), x_scale=0.05, xtol=1e-6)
        value[freed] = found.x
    freedom = int(sample.valid.sum()) - 2 * len(sample) - int(freed.sum())
    chi2 = 2.0 * float(found.cost) / freedom
    covariance = np.zeros((COUNT, COUNT))
    covariance[np.ix_(freed, freed)] = np.linalg.pinv(found.jac.T @ found.jac) * max(chi2, 1.0)
    return replace(model, value=value, covariance=covariance, chi2=chi2)
