"""Star vectors against readings of known errors; the reading noise that counts like the centroids, in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.single_star.bench import Bench
from experiments.laboratory.turntable import build_turntable
from experiments.turntable.evaluation import vector_scatter_arcsec
from experiments.turntable.monte_carlo import ReadingPoint, equal_reading_noise_arcsec
from optics.units import ARCSEC_RAD


def test_star_vectors_scatter_as_the_readings_do() -> None:
    """A star along Z: a turn about Y moves its vector along X, one about X moves it along Y; near zero angles."""
    camera = BrownConrady.create(
        SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055), focal_length_mm=40.0
    )
    bench = Bench(table=build_turntable("xy"), star=np.array([0.0, 0.0, 1.0]), installation=Rotation.identity())
    rng = np.random.default_rng(4)
    true = rng.uniform(-0.02, 0.02, (60, 2))
    error = rng.standard_normal((60, 2)) * np.array([3.0, 7.0])  # arcsec, about X and about Y
    measurement = SimpleNamespace(
        bench=bench,
        visits=SimpleNamespace(reading_rad=true + error * ARCSEC_RAD),
        readings=SimpleNamespace(position_px=camera.project(bench.seen(true))),
    )
    reduction = SimpleNamespace(calibration=SimpleNamespace(model=camera, installation=Rotation.identity()))
    # the angles are below 0.02 rad: their cosine is 1 to 2e-4
    np.testing.assert_allclose(vector_scatter_arcsec(reduction, measurement), error.std(0, ddof=1)[::-1], rtol=1e-3)


def _points(noises: tuple[float, ...], slope: float, base: float) -> list[ReadingPoint]:
    return [
        ReadingPoint(
            reading_arcsec=noise,
            measured_arcsec=1.0,
            uncertainty_arcsec=0.1,
            bound_arcsec=float(np.hypot(base, slope * noise)),
            pull_rms=1.0,
            runs=10,
        )
        for noise in noises
    ]


def test_reading_noise_that_counts_like_the_centroids() -> None:
    """b^2 = 0.03^2 + (0.5 r)^2 is twice 0.03^2 at r = 0.06; without any slope there is none."""
    points = _points((0.01, 3.0, 0.3), slope=0.5, base=0.03)
    assert equal_reading_noise_arcsec(points, 0.03) == pytest.approx(0.06)
    assert np.isnan(equal_reading_noise_arcsec(_points((1.0,), slope=0.0, base=0.03), 0.03))
