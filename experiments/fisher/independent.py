"""The accuracy of star vectors by a path of its own: FISHER23's steps written out, and vectors of known noise.

Steps S300 to S500 are evaluated once more from what a laboratory would write down: images, readings, and the numbers of
the calibration. The resultant length is summed in extended precision, so that 1 - R may be subtracted as printed. Known
noise is put on vectors by two normal deviates per vector, in NumPy, without the sampler of the Fisher distribution; the
cone of confidence then has the limit of small angles as its closed form: for n directions of estimated scatter sigma,
a^2 = 2 sigma^2 F(0.95; 2, 2 n - 2) / n.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2, f

from calib.directional.fisher import fit_fisher
from experiments.laboratory.plain_formulae import ARCSEC, acf_matrix, acf_rays, star_vector, table_matrices
from optics.arrays import FloatArray
from render.engine.random import Streams

if TYPE_CHECKING:
    from calib.calibration.record import Calibration
    from experiments.fisher.acquire import Acquisition
    from experiments.fisher.settings import Config

__all__ = ["LEVEL", "KnownNoise", "known_noise", "mean_probability", "written_out_arcsec", "written_out_vectors"]


LEVEL = 0.95
"""Of the cone of confidence."""
COUNT, RUNS, SIGMA_ARCSEC = 60, 400, 2.0
"""Vectors in a sample of known noise, samples, and the noise that is put in, per axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownNoise:
    """Samples of vectors with known noise, evaluated."""

    variance: float  # Mean of the variances found over the variance put in
    variance_sigma: float  # Its standard deviation
    cone: float  # Largest difference of the cone of confidence from its closed form, relative
    held: float  # Part of the cones that hold the true direction, and its standard deviation
    held_sigma: float  # Part of the cones that hold the true direction, and its standard deviation


def written_out_vectors(config: Config, calibration: Calibration, acquisition: Acquisition) -> FloatArray:
    """S300: star vectors (n, 3) in the table's frame at zero angles, w = T A^T u(x, y)."""
    found = dict(zip(calibration.solution.names, calibration.solution.value, strict=True))
    geometry = calibration.model.geometry
    rays = acf_rays(
        list(calibration.model.parameters),
        acquisition.position_px,
        (geometry.width_px, geometry.height_px),
        geometry.pixel_pitch_mm,
    )
    installation = acf_matrix(*(found[f"theta{i}_rad"] for i in (1, 2, 3)))
    leans = [found[name] / ARCSEC for name in sorted(found) if name.startswith("lean")]
    tables = table_matrices(config.table.axes, acquisition.places.reading_rad, leans)
    return np.asarray(np.einsum("nij,kj,nk->ni", tables, installation, rays))


def written_out_arcsec(vectors: FloatArray) -> float:
    """S400 and S500: R = |sum w| / n, k = (n - 1) / (n (1 - R)), sigma = 1 / sqrt(k) [arcsec]."""
    w = np.asarray(vectors, np.longdouble)
    w = w / np.sqrt((w * w).sum(1))[:, None]
    total, count = w.sum(0), len(w)
    length = np.sqrt((total * total).sum()) / count
    return float(np.sqrt(count * (1 - length) / (count - 1)) / ARCSEC)


def mean_probability(config: Config, calibration: Calibration, vectors: FloatArray, sigma_arcsec: float) -> float:
    """Probability of a mean star vector at least as far from the direction that was set.

    By the covariance of the calibrated direction, in azimuth and elevation, and that of the mean.
    """
    azimuth, elevation = np.radians(config.star.azimuth_deg), np.radians(config.star.elevation_deg)
    mean = vectors.mean(0)
    step = 1e-6
    rates = np.column_stack(
        [
            (star_vector(azimuth + step, elevation) - star_vector(azimuth - step, elevation)) / (2 * step),
            (star_vector(azimuth, elevation + step) - star_vector(azimuth, elevation - step)) / (2 * step),
        ]
    )
    apart = np.linalg.lstsq(rates, mean - star_vector(azimuth, elevation), rcond=None)[0]
    names = list(calibration.solution.names)
    at = [names.index("star_azimuth_rad"), names.index("star_elevation_rad")]
    own = (sigma_arcsec * ARCSEC) ** 2 / len(vectors) * np.linalg.inv(rates.T @ rates)
    covariance = np.asarray(calibration.solution.covariance)[np.ix_(at, at)] + own
    return float(chi2.sf(apart @ np.linalg.solve(covariance, apart), 2))


def known_noise(streams: Streams) -> KnownNoise:
    """Put known noise on vectors, and see what the estimator makes of it."""
    rng = streams.generator("known noise")
    found, cones, held = [], [], 0
    for _ in range(RUNS):
        true = rng.standard_normal(3)
        true /= np.sqrt(true @ true)
        apart = rng.standard_normal((COUNT, 3)) * SIGMA_ARCSEC * ARCSEC
        vectors = true + apart - np.outer(apart @ true, true)
        vectors /= np.sqrt((vectors**2).sum(1))[:, None]
        fit = fit_fisher(vectors)
        found.append((fit.sigma_rad / (SIGMA_ARCSEC * ARCSEC)) ** 2)
        plain = written_out_arcsec(vectors) * ARCSEC
        closed = plain * np.sqrt(2.0 * f.ppf(LEVEL, 2, 2 * COUNT - 2) / COUNT)
        cone = fit.mean_cone_rad(LEVEL)
        cones.append(abs(cone / closed - 1.0))
        mean = vectors.mean(0)
        held += float(np.sqrt(((mean / np.sqrt(mean @ mean) - true) ** 2).sum())) <= cone
    return KnownNoise(
        variance=float(np.mean(found)),
        variance_sigma=float(1.0 / np.sqrt((COUNT - 1) * RUNS)),
        cone=max(cones),
        held=held / RUNS,
        held_sigma=float(np.sqrt(LEVEL * (1 - LEVEL) / RUNS)),
    )
