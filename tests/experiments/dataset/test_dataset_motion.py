"""Frames of a camera that turns: smear and positions against chief rays of the other trace at single times."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from experiments.dataset.frame import FrameMaker
from experiments.dataset.scene import build_scene
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


LAG = 0.1
LAGGING = {"exposure_s": 0.2, "width_px": 256, "height_px": 192}
SCAN = ScanPointing(ra_deg=56.75, dec_deg=24.12, rate_deg_per_s=(0.0, 0.004, 0.0), frame_rate_hz=0.05)


@pytest.fixture(scope="module")
def detectors(tmp_path_factory):
    """Two chips that differ in nothing but their lag."""
    folder = tmp_path_factory.mktemp("chips")
    for name, lag in (("rests", 0.0), ("lags", LAG)):
        (folder / f"{name}.toml").write_text(f'base = "cmv4000"\nlag = {lag}\n')
    return {name: str(folder / f"{name}.toml") for name in ("rests", "lags")}


def maker_of(detector, pointing=SCAN, **more):
    settings = {"nodes": 2, "catalogue": CatalogueConfig(faintest_mag=8.0), "pointing": pointing}
    return FrameMaker(
        build_scene(Config(instrument=InstrumentConfig(detector=detector, **LAGGING), **settings, **more))
    )


def test_a_scan_keeps_what_the_frame_before_left(engine, detectors):
    """Rationale: image persistence is of the frame before, whoever makes the frames and in whatever order.

    Expected behaviour: where a star stood one frame ago stands the share of its electrons that the data file names; a
    frame made alone is the same as one made after the frame before.
    """
    lags, rests = maker_of(detectors["lags"]), maker_of(detectors["rests"])
    before, after, without = lags.make(0), lags.make(1), rests.make(1)
    np.testing.assert_array_equal(before.frame.dn, rests.make(0).frame.dn)
    np.testing.assert_array_equal(after.frame.dn, maker_of(detectors["lags"]).make(1).frame.dn)
    truth = before.truth
    left = (after.frame.dn.astype(float) - without.frame.dn) / after.frame.gain_dn_per_e
    inside = (np.abs(truth["photon_x_px"] - 127.5) < 120) & (np.abs(truth["photon_y_px"] - 95.5) < 88)
    chosen = np.flatnonzero(inside & (truth["flags"] == 0) & (truth["electrons"] > 3000.0))
    assert len(chosen) >= 2
    for i in chosen:
        x, y = round(float(truth["photon_x_px"][i])), round(float(truth["photon_y_px"][i]))
        part = left[y - 4 : y + 5, x - 4 : x + 5]
        expected = LAG * truth["electrons"][i]
        # the draws of both frames differ where their expectations do; 2 e- of sky are left in every pixel as well
        assert abs(part.sum() - expected) < 5.0 * np.sqrt(2.0 * expected + part.size * 10.0) + 0.05 * expected


@pytest.mark.slow
def test_frames_that_do_not_follow_each_other_have_none_before(engine, detectors):
    cone = ConePointing(ra_deg=56.75, dec_deg=24.12, radius_deg=0.1)
    lags, rests = (maker_of(detectors[name], cone) for name in ("lags", "rests"))
    lags.make(0)
    np.testing.assert_array_equal(lags.make(1).frame.dn, rests.make(1).frame.dn)
