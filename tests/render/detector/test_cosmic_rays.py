"""Cosmic rays: closed forms of an isotropic flux, charge on its track, frames and windows."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from render.detector.cosmic_rays import CosmicRayHits, cosmic_ray_environment, cosmic_ray_hits, list_environments
from render.detector.ionisation_loss import PAIR_ENERGY_EV, knock_on_limit_ev, restricted_loss_ev_per_um
from render.detector.readout import expose, expose_windows
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams

SHIPPED = dataclasses.replace(load_detector("cmv4000"), chip_width_px=512, chip_height_px=256)
AREA_CM2 = 512 * 256 * (5.5e-4) ** 2
EXPOSURE_S = 6e4
QUIET = "deep_space_solar_minimum"


def drawn(environment: Any = QUIET, *, detector: Detector = SHIPPED, frame: int = 0, **options: Any) -> CosmicRayHits:
    settings: dict[str, Any] = {"exposure_s": 1.0, "depth_um": 10.0} | options
    return cosmic_ray_hits(detector, environment, streams=Streams(5), frame=frame, **settings)


@pytest.fixture(scope="module")
def many() -> CosmicRayHits:
    """Some 5800 tracks."""
    return drawn(exposure_s=EXPOSURE_S)


def test_rate_of_an_isotropic_flux(many: CosmicRayHits) -> None:
    """Through a flat layer go flux / 2 particles per area and time; Poisson, 4 sigma. Everywhere alike."""
    expected = 4.8983 / 2 * AREA_CM2 * EXPOSURE_S
    assert abs(len(many) - expected) < 4 * np.sqrt(expected)
    for place, size in ((many.x_px, 512), (many.y_px, 256)):
        share = (place + 0.5) / size
        assert abs(share.mean() - 0.5) < 4 / np.sqrt(12 * len(many))
        assert 0 <= share.min() <= share.max() <= 1


def test_angles_and_mean_path(many: CosmicRayHits) -> None:
    """cos^2 is uniform (projected area), so the mean path is 2 depths, up to the cut at the diagonal (c = 0.003).

    Of s = depth / max(cos, c): mean depth (2 - c), mean square depth^2 (1 - 2 ln c).
    """
    n, shortest = len(many), 10.0 / (np.hypot(512, 256) * 5.5)
    square = many.cos_zenith**2
    assert abs(square.mean() - 0.5) < 4 / np.sqrt(12 * n)
    scatter = np.sqrt(1 - 2 * np.log(shortest) - 4)
    assert abs(many.path_um.mean() / 10.0 - (2 - shortest)) < 4 * scatter / np.sqrt(n)
    assert abs(np.cos(many.azimuth_rad).mean()) < 4 / np.sqrt(2 * n)


def test_charge_per_path(many: CosmicRayHits) -> None:
    """Electrons per um of track: Bethe's loss over 3.65 eV, per nucleus and energy; 4 standard errors."""
    limit = knock_on_limit_ev(10.0)
    wanted = restricted_loss_ev_per_um(many.energy_mev, many.nucleus_charge, limit_ev=limit) / PAIR_ENERGY_EV
    for charge in (1.0, 2.0, 8.0):
        part = many.nucleus_charge == charge
        ratio = many.freed_e[part] / (many.path_um[part] * wanted[part])
        assert abs(ratio.mean() - 1) < 4 * ratio.std() / np.sqrt(part.sum())
    share = (many.nucleus_charge == 2.0).mean()
    assert abs(share - 0.12) < 4 * np.sqrt(0.12 * 0.88 / len(many))


def test_nothing_lost_but_over_the_edge(many: CosmicRayHits) -> None:
    """Pixels together hold what the tracks freed, less what sticks out; all of it where nothing does."""
    lost = 1 - many.charge_e.sum() / many.freed_e.sum()
    assert 0 < lost < 0.05
    assert len(np.unique(many.row * 512 + many.column)) == len(many.row)
    large, seen = dataclasses.replace(SHIPPED, chip_width_px=4096, chip_height_px=4096), 0
    for frame in range(6):
        inner = drawn(detector=large, exposure_s=0.2, frame=frame)
        if np.all(np.abs(np.stack([inner.x_px, inner.y_px]) - 2047.5).max(0) + inner.path_um / 5.5 < 2040):
            assert inner.charge_e.sum() == pytest.approx(inner.freed_e.sum(), rel=1e-4)
            seen += len(inner)
    assert seen > 3


def test_charge_lies_on_the_track() -> None:
    """Single tracks: the charge's mean lies on the track. Diffusion of 0.5 px, at which whole pixels do not alias."""
    wide, found = dataclasses.replace(SHIPPED, diffusion_sigma_mm=0.5 * SHIPPED.pixel_pitch_mm), 0
    for frame in range(60):
        hits = drawn(frame=frame, exposure_s=8.0, detector=wide)
        if len(hits) != 1 or hits.charge_e.sum() < 0.999 * hits.freed_e[0]:
            continue
        mean = np.array([hits.charge_e @ hits.column, hits.charge_e @ hits.row]) / hits.charge_e.sum()
        off = mean - [hits.x_px[0], hits.y_px[0]]
        along = np.array([np.cos(hits.azimuth_rad[0]), np.sin(hits.azimuth_rad[0])])
        run = np.sqrt(hits.path_um[0] ** 2 - 100.0) / 5.5
        assert abs(off @ along) < 0.5 * run + 0.02
        assert abs(off @ [-along[1], along[0]]) < 0.02
        found += 1
    assert found > 10


@pytest.mark.parametrize(("name", "potential_mv"), [(QUIET, 400.0), ("deep_space_solar_maximum", 1000.0)])
def test_published_flux_against_the_spectrum_of_others(name: str, potential_mv: float) -> None:
    """Robberto's flux (CREME96) is 4 pi times Usoskin's (2005) proton intensity above 25 MeV, within 10 %."""
    kinetic, rest = np.geomspace(0.025, 100.0, 2000), 0.938
    outside = kinetic + potential_mv / 1e3
    momentum2 = outside * (outside + 2 * rest)
    intensity = 1.9 * momentum2**-1.39 / (1 + 0.4866 * momentum2**-1.255)  # /(cm2 s sr GeV)
    intensity *= kinetic * (kinetic + 2 * rest) / momentum2
    assert cosmic_ray_environment(name).flux_per_cm2_s == pytest.approx(
        4 * np.pi * np.trapezoid(intensity, kinetic), rel=0.1
    )


def test_same_seed_same_hits() -> None:
    first, again, other = drawn(exposure_s=30.0), drawn(exposure_s=30.0), drawn(exposure_s=30.0, frame=1)
    for name in ("row", "column", "charge_e", "x_px", "freed_e"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.x_px[:5], other.x_px[:5])


# ---------------------------------------------------------------- in the readout


def test_adds_charge_before_full_well() -> None:
    """The frame with hits is the frame without, plus charge x gain to one DN; what exceeds full well is flagged."""
    linear = dataclasses.replace(
        SHIPPED,
        nonlinearity=(),
        adc_bits=16,
        gain_dn_per_e=2.0,
        dead_fraction=0.0,
        hot_fraction=0.0,
        full_well_e=3000.0,
    )
    hits = drawn("solar_flare", detector=linear, exposure_s=0.3)
    options: dict[str, Any] = {"streams": Streams(1), "exposure_s": 0.3}
    plain, struck = (expose(np.zeros(linear.shape), linear, hits=held, **options) for held in (None, hits))
    added = np.zeros(linear.shape)
    added[hits.row, hits.column] = hits.charge_e
    full = struck.saturated
    assert full.any()
    assert not plain.saturated.any()
    difference = struck.dn.astype(float) - plain.dn
    assert np.abs(difference - 2.0 * added)[~full & (plain.dn > 0)].max() <= 1.01
    assert added[full].min() > 3000.0 - 500.0  # the rest is dark current


def test_gaps_and_dead_pixels_collect_nothing() -> None:
    mosaic = dataclasses.replace(SHIPPED, chips=2, chip_width_px=250, gap_px=12, dead_fraction=0.05)
    hits = drawn("solar_flare", detector=mosaic, exposure_s=0.3)
    assert not np.any((hits.column >= 250) & (hits.column < 262))
    options: dict[str, Any] = {"streams": Streams(1), "exposure_s": 0.3}
    plain, struck = (expose(np.zeros(mosaic.shape), mosaic, hits=h, **options) for h in (None, hits))
    changed = plain.dn != struck.dn
    assert changed.any()
    dead = plain.defect & struck.defect
    assert changed[dead].mean() < 0.1 * changed[~dead].mean() + 1e-3  # the few hot ones among the defects


@pytest.mark.parametrize("together", [2, 1])
def test_windows_equal_the_crop(together: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two frames, together or one by one, overlapping windows, crosstalk, one window with its margin outside."""
    detector = dataclasses.replace(SHIPPED, crosstalk_horizontal=0.02, crosstalk_diagonal=0.004, full_well_e=2000.0)
    hits = [drawn("solar_flare", detector=detector, frame=f, exposure_s=0.2) for f in (7, 8)]
    image = np.random.default_rng(1).uniform(0, 100, (258, 514)).astype(np.float32)
    corner = np.array([[-1, -1], [100, 60], [110, 70], [471, 215]])
    stamps = np.stack([image[y + 1 : y + 43, x + 1 : x + 43] for x, y in corner])
    options: dict[str, Any] = {"streams": Streams(2), "exposure_s": 0.2}
    monkeypatch.setattr("render.detector.chain._FRAME_AXIS_LIMIT", together * stamps.size)
    windows = expose_windows(stamps, corner, detector, frames=2, first_frame=7, margin_px=1, hits=hits, **options)
    for number, held in enumerate(hits):
        frame = expose(image[1:-1, 1:-1], detector, frame=7 + number, hits=held, **options)
        for window, flags, (x, y) in zip(windows.dn[number], windows.saturated[number], windows.corner_px, strict=True):
            assert np.array_equal(window, frame.dn[y : y + 40, x : x + 40])
            assert np.array_equal(flags, frame.saturated[y : y + 40, x : x + 40])
    assert (windows.dn > 500).any()


# ---------------------------------------------------------------- bad input


def test_every_environment_names_its_source() -> None:
    for name in list_environments():
        environment = cosmic_ray_environment(name)
        assert environment.name == name
        assert any(year in environment.source for year in ("2009", "2021"))
        assert environment.energy_share.sum() == pytest.approx(1.0)


def test_protons_of_a_flare_fall_by_e_every_26_5_mev_and_the_layer_is_10_um_unless_said() -> None:
    """King 1974, J. Spacecraft 11, 401: exp(-E / 26.5 MeV) above 30 MeV."""
    flare = cosmic_ray_environment("solar_flare")
    ratio = np.interp(126.5, flare.energy_mev, np.log(flare.energy_share)) - np.interp(
        100.0, flare.energy_mev, np.log(flare.energy_share)
    )
    assert ratio == pytest.approx(-1.0, rel=1e-9)
    said = drawn(exposure_s=1e3)
    unsaid = cosmic_ray_hits(SHIPPED, QUIET, streams=Streams(5), frame=0, exposure_s=1e3)
    assert np.array_equal(said.path_um, unsaid.path_um)
