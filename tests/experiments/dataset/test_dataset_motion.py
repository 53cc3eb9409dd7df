"""Frames of a camera that turns: smear and positions against chief rays of the other trace at single times."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from experiments.dataset.frames.maker import FrameMaker
from experiments.dataset.frames.scene import build_scene
from experiments.dataset.settings import ConePointing, Config, FixedRate, ScanPointing
from experiments.laboratory.settings import CatalogueConfig, InstrumentConfig
from optics.frames import field_angles_deg
from optics.rays.chief import chief_ray_points

RATE_DEG_PER_S = (0.01, -0.015, 0.05)


def chief_px(scene, direction, attitude, wavelength_nm):
    """Pixels (n, 2) of chief rays by NumPy."""
    camera = scene.instrument.camera
    angles = field_angles_deg(attitude.apply(direction))
    return np.stack(camera.to_pixel(*chief_ray_points(camera.focused_lens, *angles, wavelength_nm)), axis=1)


@pytest.mark.parametrize(("scanned", "line_time_us"), [(False, 200.0), pytest.param(True, 0.0, marks=pytest.mark.slow)])
def test_smear_and_place(engine, scanned, line_time_us):
    sensor = {"detector": "cmv4000", "exposure_s": 0.2, "width_px": 256, "height_px": 192, "line_time_us": line_time_us}
    pleiades = {"ra_deg": 56.75, "dec_deg": 24.12, "roll_deg": 20.0}
    if scanned:
        scan = ScanPointing(**pleiades, rate_deg_per_s=RATE_DEG_PER_S, frame_rate_hz=20.0)
        settings = {"pointing": scan}
    else:
        cone = ConePointing(**pleiades, radius_deg=0.0)
        settings = {"pointing": cone, "rate": FixedRate(rate_deg_per_s=RATE_DEG_PER_S)}
    scene = build_scene(
        Config(instrument=InstrumentConfig(**sensor), nodes=3, catalogue=CatalogueConfig(faintest_mag=8.0), **settings)
    )
    made = FrameMaker(scene).make(2)
    truth, plan = made.truth, made.plan
    assert np.degrees(made.plan.rate_rad_per_s) == pytest.approx(RATE_DEG_PER_S)
    direction = SkyCoord(truth["ra_deg"], truth["dec_deg"], unit="deg").cartesian.xyz.value.T.copy()
    wavelength = float(scene.light.wavelength_nm.mean())
    starts = plan.start_s + np.clip(truth["chief_y_px"], 0, 191) * line_time_us * 1e-6
    ends = [
        np.concatenate(
            [
                chief_px(scene, direction[i : i + 1], plan.trajectory.attitude(starts[i] + part * 0.2), wavelength)
                for i in range(len(starts))
            ]
        )
        for part in (0.0, 0.5, 1.0)
    ]
    lit = truth["electrons"] > 0.5 * truth["electrons_in"]
    smear = np.stack([truth["smear_x_px"], truth["smear_y_px"]], axis=1)
    assert np.linalg.norm(smear, axis=1).max() > 2.0
    assert len(smear[lit]) >= 4
    assert smear[lit] == pytest.approx((ends[2] - ends[0])[lit], abs=2e-3)  # at another wavelength
    chief = np.stack([truth["chief_x_px"], truth["chief_y_px"]], axis=1)
    assert chief[lit] == pytest.approx(ends[1][lit], abs=2e-3)
    spot = np.stack([truth["variance_x_px2"], truth["variance_y_px2"]], axis=1) - smear**2 / 12.0
    assert (spot[lit] > 0).all()  # a uniform path of length s has the variance s^2 / 12
    assert (spot[lit] < 1.5).all()
    middle = plan.trajectory.attitude(plan.start_s + 0.5 * (0.2 + 191 * line_time_us * 1e-6))
    assert (middle * plan.attitude.inv()).magnitude() < 1e-12
