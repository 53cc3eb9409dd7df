"""The same camera on other tables: what star vectors scatter when the table is read better or worse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras.base import CameraModel
from calib.directional.fisher import fit_fisher
from experiments.laboratory.single_star.bench import Bench
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC
from render.engine.random import Streams

__all__ = ["TablePoint", "table_share", "table_sweep"]


READINGS_ARCSEC = (0.01, 0.03, 0.1, 0.2, 0.4, 0.8)
RUNS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class TablePoint:
    """One reading noise of the table, all axes alike."""

    reading_arcsec: float  # Standard deviation of a reading
    sigma_arcsec: float  # What the method gives, mean over runs, and its standard error
    error_arcsec: float  # What the method gives, mean over runs, and its standard error
    expected_arcsec: float  # Root of the sum of squares of camera and table


def table_sweep(
    model: CameraModel,
    bench: Bench,
    angle_rad: FloatArray,
    camera_arcsec: float,
    sigma_px: float,
    streams: Streams,
    readings_arcsec: Sequence[float] = READINGS_ARCSEC,
) -> list[TablePoint]:
    """Repeat the acquisition on coordinates, calibration known, with other tables."""
    angle = np.array(angle_rad)
    exact = model.project(bench.seen(angle))
    points = []
    for i, noise in enumerate(readings_arcsec):
        table = replace(bench.table, reading_noise_arcsec=np.full(angle.shape[1], noise))
        found = []
        for run in range(RUNS):
            own = streams.child("table", i, run)
            pixel = exact + sigma_px * own.generator("centroids").standard_normal(exact.shape)
            turn = table.rotation(table.read(angle, own))
            vectors = initial_frame_vectors(model, pixel, installation=bench.installation, table_rotation=turn)
            found.append(fit_fisher(vectors).sigma_rad * RAD_ARCSEC)
        points.append(
            TablePoint(
                reading_arcsec=noise,
                sigma_arcsec=float(np.mean(found)),
                error_arcsec=float(np.std(found, ddof=1) / np.sqrt(RUNS)),
                expected_arcsec=float(np.hypot(camera_arcsec, table_share(bench, angle) * noise)),
            )
        )
    return points


def table_share(bench: Bench, angle_rad: FloatArray) -> float:
    """Noise of a star vector per axis over that of a reading, all axes alike: mean over the places of |Z x s|^2 / 2."""
    across = np.cross(bench.table.angle_rates(angle_rad), bench.star)
    return float(np.sqrt(np.einsum("nki,nki->n", across, across).mean() / 2.0))
