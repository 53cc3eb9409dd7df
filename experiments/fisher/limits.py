"""Two limits of the method: the digits of 1 - R, and the table that carries the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext

import numpy as np

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras.base import CameraModel
from calib.directional.fisher import fit_fisher, sample_fisher
from experiments.laboratory.single_star.bench import Bench
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_ARCSEC
from render.engine.random import Streams

__all__ = ["DigitsPoint", "TablePoint", "digits_sweep", "table_sweep"]


MEAN = np.array([0.48, -0.6, 0.64])
VECTORS = 400
REFERENCE_DIGITS = 50
SIGMAS_ARCSEC = (100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
TABLE_ARCSEC = (0.01, 0.03, 0.1, 0.2, 0.4, 0.8)
TABLE_RUNS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class DigitsPoint:
    """Relative error of the concentration 1/(1 - R) of one sample, against 50 digits.

    Attributes
    ----------
    sigma_arcsec : float
        Standard deviation per axis of the vectors.
    chords : float
        By sums of squared chords.
    subtraction : float
        By 1 - R in double precision; infinite where that is 0.
    scipy : float
        By `scipy.stats.vonmises_fisher.fit`, which solves eq. 10; NaN where it gives up.
    """

    sigma_arcsec: float
    chords: float
    subtraction: float
    scipy: float


def digits_sweep(streams: Streams, sigmas_arcsec: Sequence[float] = SIGMAS_ARCSEC) -> list[DigitsPoint]:
    """Estimate one sample of vectors in three ways, for one noise after the other."""
    points = []
    for i, sigma in enumerate(sigmas_arcsec):
        vectors = sample_fisher(MEAN, (sigma * ARCSEC_RAD) ** -2, VECTORS, streams.generator("digits", i))
        exact = _deficit(vectors)
        naive = 1.0 - float(np.linalg.norm(vectors.mean(0)))
        points.append(
            DigitsPoint(
                sigma_arcsec=sigma,
                chords=abs(fit_fisher(vectors).concentration_document * exact - 1.0),
                subtraction=abs(exact / naive - 1.0) if naive != 0.0 else float("inf"),
                scipy=_by_scipy(vectors, exact),
            )
        )
    return points


def _deficit(vectors: FloatArray) -> float:
    """1 - R, literally, in 50 digits."""
    with localcontext() as context:
        context.prec = REFERENCE_DIGITS
        total = [Decimal(0)] * 3
        for row in vectors:
            parts = [Decimal(float(x)) for x in row]
            length = sum((x * x for x in parts), Decimal(0)).sqrt()
            total = [a + x / length for a, x in zip(total, parts, strict=True)]
        return float(1 - sum((x * x for x in total), Decimal(0)).sqrt() / len(vectors))


def _by_scipy(vectors: FloatArray, exact: float) -> float:
    from scipy.stats import vonmises_fisher

    try:
        with np.errstate(all="ignore"):
            concentration = float(vonmises_fisher.fit(vectors)[1])
    except (ValueError, RuntimeError, ArithmeticError):  # no bracket, no convergence
        return float("nan")
    return abs(concentration * exact - 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePoint:
    """One reading noise of the table, all axes alike.

    Attributes
    ----------
    reading_arcsec : float
        Standard deviation of a reading.
    sigma_arcsec, error_arcsec : float
        What the method gives, mean over runs, and its standard error.
    expected_arcsec : float
        Root of the sum of squares of camera and table.
    """

    reading_arcsec: float
    sigma_arcsec: float
    error_arcsec: float
    expected_arcsec: float


def table_sweep(
    model: CameraModel,
    bench: Bench,
    angle_rad: FloatArray,
    camera_arcsec: float,
    sigma_px: float,
    streams: Streams,
    readings_arcsec: Sequence[float] = TABLE_ARCSEC,
) -> list[TablePoint]:
    """Repeat the acquisition on coordinates, calibration known, with other tables.

    Parameters
    ----------
    model, bench
        The truth.
    angle_rad : (n, k)
        Angles of the table.
    camera_arcsec, sigma_px : float
        Noise of an image, as an angle per axis and in pixels.
    streams : Streams
        Root of the randomness.
    readings_arcsec : sequence of float
        Reading noises.
    """
    angle = np.array(angle_rad)
    exact = model.project(bench.seen(angle))
    points = []
    for i, noise in enumerate(readings_arcsec):
        table = replace(bench.table, reading_noise_arcsec=np.full(angle.shape[1], noise))
        found = []
        for run in range(TABLE_RUNS):
            own = streams.child("table", i, run)
            pixel = exact + sigma_px * own.generator("centroids").standard_normal(exact.shape)
            turn = table.rotation(table.read(angle, own))
            vectors = initial_frame_vectors(model, pixel, installation=bench.installation, table_rotation=turn)
            found.append(fit_fisher(vectors).sigma_rad * RAD_ARCSEC)
        points.append(
            TablePoint(
                reading_arcsec=noise,
                sigma_arcsec=float(np.mean(found)),
                error_arcsec=float(np.std(found, ddof=1) / np.sqrt(TABLE_RUNS)),
                expected_arcsec=float(np.hypot(camera_arcsec, table_share(bench, angle) * noise)),
            )
        )
    return points


def table_share(bench: Bench, angle_rad: FloatArray) -> float:
    """Noise of a star vector per axis over that of a reading, all axes alike: mean over the places of |Z x s|^2 / 2."""
    across = np.cross(bench.table.angle_rates(angle_rad), bench.star)
    return float(np.sqrt(np.einsum("nki,nki->n", across, across).mean() / 2.0))
