"""An effective PSF from star images at different fractions of a pixel.

After Anderson & King (2000, PASP 112, 1360): from first positions and fluxes build the PSF on a grid finer than the
pixel, measure positions and fluxes with it, and repeat. They average residuals in grid cells and smooth; here the
spline coefficients solve one weighted, slightly smoothed linear least-squares problem, without blur over cells.

One set of stars does not determine a common error that depends on the position within the pixel: moving every star by
g(phase) and warping the PSF accordingly leaves all predicted pixels unchanged. Only stars at several phases fix it: the
position in one frame must equal the position in another plus a shift of the whole frame. Pass ``star_index`` and
``frame_index`` for this (Anderson & King's dithers), or ``position_px``, independent positions (catalogue stars through
a calibrated camera). Without either the S-curve of the first Gaussian fit remains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import solveh_banded
from scipy.ndimage import correlate1d, spline_filter
from scipy.sparse.linalg import spsolve

from calib.flags import StarFlag, has_flag
from calib.measure.centroiders.epsf import EpsfCentroider
from calib.measure.centroiders.gaussian import GaussianCentroider
from calib.measure.epsf.bspline import cubic_weights
from calib.records import NoiseModel, Stamps, StarTable
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.records import EffectivePsf

_UNFIT = StarFlag.SATURATED | StarFlag.BLEND | StarFlag.SPIKE | StarFlag.NO_DATA | StarFlag.NOT_CONVERGED


@dataclass(frozen=True, slots=True, kw_only=True)
class EpsfSolution:
    """Result of `build_epsf`."""

    epsf: EffectivePsf  # The PSF. Its origin is its centre of light, its sum over a phase is 1 within the window
    stars: StarTable  # All stars measured with it
    converged: bool  # Whether the positions converged
    iterations: int  # Number of iterations
    last_shift_px: float  # RMS change of the positions in the last iteration
    chi2: float  # Mean of the stars' reduced chi-square
    used: NDArray[np.bool_]  # (n,) Stars of the fit
    message: str = ""  # Why positions did not converge


def build_epsf(
    stamps: Stamps,
    noise: NoiseModel,
    *,
    star_index: ArrayLike | None = None,
    frame_index: ArrayLike | None = None,
    position_px: ArrayLike | None = None,
    oversampling: int = 4,
    roughness: float = 0.03,
    fit_background: bool = False,
    max_iterations: int = 40,
    tolerance: float = 0.02,
) -> EpsfSolution:
    """Effective PSF of stars that all share it.

    Parameters
    ----------
    stamps : Stamps
        Star images, e.g. of several dithered frames; at least ``oversampling^2`` without flags. Saturated and blended
        stars are measured but not used for the PSF.
    noise : NoiseModel
        Noise of a pixel.
    star_index, frame_index : (n,) int, optional
        Star and frame of each stamp, for the same stars in frames that differ by a shift. Positions are then star +
        frame shift while the PSF is built.
    position_px : (n, 2), optional
        Positions (column, row) of the stars, e.g. of the catalogue through a calibrated camera; stars with NaN are not
        used. They are held fixed while the PSF is built, and are its origin in place of its centre of light. Errors
        common to a frame shift the PSF, others widen it.
    oversampling : int
        Samples per pixel of the result, 1 to 16.
    roughness : float
        Expected third difference of the PSF over a quarter of a pixel, relative to its peak (standard deviation of a
        normal prior), to which noisy data are smoothed.
    fit_background : bool
        Fit a constant per star.
    max_iterations : int
        Largest number of iterations.
    tolerance : float
        Change of the positions, relative to their standard deviation (RMS), below which they have converged.

    Returns
    -------
    EpsfSolution

    Raises
    ------
    DomainError
        On too few usable stars or an option out of range.
    """
    if not 1 <= oversampling <= 16:
        raise DomainError(f"oversampling = {oversampling}; it must be 1 to 16")
    if not roughness > 0:
        raise DomainError(f"roughness = {roughness}; it must be positive")
    if (star_index is None) != (frame_index is None):
        raise DomainError("star_index and frame_index belong together; give both or none")
    if position_px is not None and star_index is not None:
        raise DomainError("give either position_px or star_index; known positions need no dithers")
    fixed_px = None if position_px is None else _positions(position_px, len(stamps))
    dither = None
    if star_index is not None and frame_index is not None:
        dither = _Dither(star_index, frame_index, len(stamps))
    stars = GaussianCentroider(fit_background=fit_background).measure(stamps, noise)
    usable = np.ones(len(stamps), bool) if fixed_px is None else np.asarray(np.isfinite(fixed_px).all(axis=1))
    used = ~has_flag(stars.flags, _UNFIT) & usable
    if used.sum() < oversampling**2:
        raise DomainError(
            f"{int(used.sum())} usable stars; an ePSF of oversampling {oversampling} needs at least {oversampling**2}"
        )
    grid = _Grid(max(stamps.window), oversampling)
    epsf: EffectivePsf | None = None
    converged, shift, iterations, relative_shift = False, np.inf, 0, np.inf
    while not converged and iterations < max_iterations:
        placed = stars if dither is None else dither.fitted(stars, used)
        if fixed_px is not None:
            x_px, y_px = np.where(usable[:, None], fixed_px, 0.0).T
            placed = replace(stars, x_px=x_px, y_px=y_px)
        epsf, centre = grid.solve(stamps, placed, noise, used=used, roughness=roughness, last=epsf)
        new = EpsfCentroider(epsf=epsf, fit_background=fit_background).measure(_restart(stamps, stars), noise)
        used = ~has_flag(new.flags, _UNFIT) & usable
        both = used & np.isfinite(stars.x_px)
        if both.sum() < oversampling**2:
            raise DomainError(
                f"only {int(both.sum())} stars could be measured with the PSF; more or brighter stars are needed"
            )
        step = (new.pixel_px - stars.pixel_px)[both]
        sigma = np.column_stack([new.sigma_x_px, new.sigma_y_px])[both]
        shift = float(np.sqrt(np.mean(step**2)))
        relative_shift = float(np.sqrt(np.mean((step / sigma) ** 2)))
        converged = relative_shift < tolerance
        # the next PSF is built around its centre of light: the data do not determine the origin
        moved = fixed_px is None and not converged
        stars = replace(new, x_px=new.x_px + centre[0], y_px=new.y_px + centre[1]) if moved else new
        iterations += 1
    if epsf is None:
        raise DomainError(f"max_iterations = {max_iterations}; at least one round is needed")
    return EpsfSolution(
        epsf=epsf,
        stars=stars,
        converged=converged,
        iterations=iterations,
        last_shift_px=shift,
        chi2=float(np.mean(stars.chi2[used])),
        used=used,
        message=""
        if converged
        else f"positions still move by {shift:.2g} px, {relative_shift:.2g} of their standard deviation (tolerance "
        f"{tolerance:g}), after {iterations} rounds: {int(used.sum())} stars for {oversampling**2} phases; more stars, "
        "a larger roughness or known places (position_px) determine them",
    )


def _positions(position_px: ArrayLike, count: int) -> FloatArray:
    position = np.asarray(position_px, np.float64)
    if position.shape != (count, 2):
        shape = position.shape
        raise DomainError(f"position_px has shape {shape}; ({count}, 2) is needed, column and row of every stamp")
    return position


def _restart(stamps: Stamps, stars: StarTable) -> Stamps:
    """The stamps with the last positions as start."""
    return replace(stamps, start_px=np.where(np.isfinite(stars.pixel_px), stars.pixel_px, stamps.start_px))


class _Dither:
    """Positions as star + shift of the frame, by weighted least squares."""

    def __init__(self, star_index: ArrayLike, frame_index: ArrayLike, count: int) -> None:
        columns = []
        for label, values in (("star_index", star_index), ("frame_index", frame_index)):
            array = np.asarray(values)
            if array.shape != (count,) or array.dtype.kind not in "iu":
                raise DomainError(f"{label} has shape {array.shape}, type {array.dtype}; {count} integers are needed")
            columns.append(np.unique(array, return_inverse=True)[1])
        stars = int(columns[0].max(initial=-1)) + 1
        total = stars + int(columns[1].max(initial=-1)) + 1
        index = np.column_stack([columns[0], columns[1] + stars]).ravel()
        self.design = sparse.csr_matrix((np.ones(2 * count), index, np.arange(count + 1) * 2), shape=(count, total))

    def fitted(self, stars: StarTable, used: NDArray[np.bool_]) -> StarTable:
        """The table with the positions of the used stars replaced by the fitted ones."""
        design = self.design[used]
        position = {}
        for name, sigma in (("x_px", stars.sigma_x_px), ("y_px", stars.sigma_y_px)):
            weight = sigma[used] ** -2
            normal = design.T @ sparse.diags(weight) @ design
            # the ridge fixes undetermined parameters: a shift of all stars against all frames, unused stars
            ridge = 1e-9 * weight.mean() * sparse.identity(normal.shape[0])
            values = np.array(getattr(stars, name))
            zero = values[used].mean()
            estimate = spsolve((normal + ridge).tocsc(), design.T @ (weight * (values[used] - zero)))
            values[used] = design @ estimate + zero
            position[name] = values
        return replace(stars, **position)


def _solve_banded(matrix: sparse.spmatrix, right: FloatArray) -> FloatArray:
    """Solution with a symmetric positive definite matrix whose elements lie near the diagonal (Cholesky)."""
    upper = sparse.triu(matrix).tocoo()
    width = int((upper.col - upper.row).max())
    band = np.zeros((width + 1, matrix.shape[0]))
    np.add.at(band, (width + upper.row - upper.col, upper.col), upper.data)
    return np.asarray(solveh_banded(band, right))


class _Grid:
    """Least squares for spline coefficients on a square grid that covers a window around its star."""

    def __init__(self, window: int, oversampling: int) -> None:
        self.step = oversampling
        self.half = (window // 2 + 1) * oversampling
        self.size = 2 * self.half + 1
        self.window = window

    def design(self, stamps: Stamps, stars: StarTable, used: NDArray[np.bool_]) -> sparse.csr_matrix:
        """Spline weights of every pixel (row) on every coefficient (column)."""
        _, height, width = stamps.electrons.shape
        x = stars.x_px[used] - stamps.corner_px[used, 0]
        y = stars.y_px[used] - stamps.corner_px[used, 1]
        taps = []
        for centre, length in ((y, height), (x, width)):
            sample = (np.arange(length) - centre[:, None]) * self.step + self.half
            cell = np.floor(sample).astype(np.int64)
            tap = cell[..., None] + np.arange(-1, 3)
            inside = (tap >= 0) & (tap < self.size)
            taps.append((np.where(inside, tap, 0), cubic_weights(sample - cell)[0] * inside))
        (row, row_weight), (column, column_weight) = taps
        index = row[:, :, None, :, None] * self.size + column[:, None, :, None, :]
        weight = row_weight[:, :, None, :, None] * column_weight[:, None, :, None, :]
        pixels = len(x) * height * width
        pointer = np.arange(pixels + 1) * 16
        return sparse.csr_matrix((weight.ravel(), index.ravel(), pointer), shape=(pixels, self.size**2))

    def penalty(self) -> sparse.csr_matrix:
        """Sum of squared third differences along both axes."""
        third = sparse.diags([-1.0, 3.0, -3.0, 1.0], [0, 1, 2, 3], shape=(self.size - 3, self.size))
        square, identity = third.T @ third, sparse.identity(self.size)
        return (sparse.kron(square, identity) + sparse.kron(identity, square)).tocsr()

    def solve(
        self,
        stamps: Stamps,
        stars: StarTable,
        noise: NoiseModel,
        *,
        used: NDArray[np.bool_],
        roughness: float,
        last: EffectivePsf | None,
    ) -> tuple[EffectivePsf, tuple[float, float]]:
        """PSF for the given positions and fluxes, and its centre of light (x, y) [px]."""
        design = self.design(stamps, stars, used)
        shape = stamps.electrons[used].shape
        flux = np.repeat(stars.flux_e[used], shape[1] * shape[2])
        background = np.repeat(stars.background_e[used], shape[1] * shape[2])
        light = stamps.electrons[used].ravel() - background
        # expectation: the light of the data, clipped, in the first iteration, of the last PSF in others
        expected = np.maximum(light, 0.0) if last is None else flux * (design @ self.coefficients(last))
        weight = np.sqrt(stamps.valid[used].ravel() / noise.variance_e2(expected + background))
        scaled = sparse.diags(weight * flux) @ design
        normal = scaled.T @ scaled
        # the peak of the PSF in a pixel, from the brightest pixels of the stars
        peak = np.median((light.reshape(shape) * stamps.valid[used]).max(axis=(1, 2)) / stars.flux_e[used])
        prior = (roughness * peak * (4.0 / self.step) ** 3) ** -2 * self.penalty()
        ridge = 1e-9 * normal.diagonal().mean() * sparse.identity(self.size**2)
        nodes = _solve_banded(normal + prior + ridge, scaled.T @ (weight * light)).reshape(self.size, self.size)
        values = np.pad(nodes, 1)
        for axis in (0, 1):
            values = correlate1d(values, np.array([1.0, 4.0, 1.0]) / 6.0, axis=axis, mode="constant")
        return self.normalise(values)

    def coefficients(self, epsf: EffectivePsf) -> FloatArray:
        """Coefficients that interpolate a PSF of this grid."""
        return np.asarray(spline_filter(np.pad(epsf.values, 12), order=3, mode="mirror")[13:-13, 13:-13].ravel())

    def normalise(self, values: FloatArray) -> tuple[EffectivePsf, tuple[float, float]]:
        """Sum over one phase set to 1; centre of light within the window's radius."""
        total = float(values.sum()) / self.step**2
        if not total > 0:
            raise DomainError("the stars contain no light for a PSF")
        offset = (np.arange(len(values)) - len(values) // 2) / self.step
        near = offset[:, None] ** 2 + offset**2 <= (0.5 * self.window) ** 2
        weight = values * near
        centre = (float(weight.sum(axis=0) @ offset / weight.sum()), float(weight.sum(axis=1) @ offset / weight.sum()))
        return EffectivePsf(values=values / total, oversampling=self.step), centre
