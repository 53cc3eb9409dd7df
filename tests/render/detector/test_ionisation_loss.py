"""Energy loss in silicon against printed values of others."""

import numpy as np
import pytest

from render.detector.ionisation_loss import draw_collisions, knock_on_limit_ev, restricted_loss_ev_per_um

DENSITY = 2.329


def test_mean_loss_without_a_limit() -> None:
    """Minimum 1.664 MeV cm2/g (Particle Data Group); a nucleus loses as its charge squared."""
    energy = np.geomspace(100.0, 1e5, 400)
    per_gram = restricted_loss_ev_per_um(energy) * 1e-2 / DENSITY
    assert per_gram.min() == pytest.approx(1.664, rel=0.005)
    assert 2000.0 < energy[per_gram.argmin()] < 3000.0  # beta gamma 3 to 4
    assert restricted_loss_ev_per_um(500.0, 8) == pytest.approx(64 * restricted_loss_ev_per_um(500.0))


def losses(path_um: float, count: int, *, limit_um: float, energy_mev: float = 2500.0) -> np.ndarray:
    collisions = draw_collisions(
        np.full(count, path_um),
        np.full(count, energy_mev),
        1,
        limit_ev=knock_on_limit_ev(limit_um),
        generator=np.random.default_rng(3),
    )
    return np.bincount(collisions.track, collisions.energy_ev, count)


def test_collisions_add_up_to_the_mean() -> None:
    """N = 20 000 tracks of 20 um, 4 standard errors of their own scatter."""
    found = losses(20.0, 20_000, limit_um=10.0)
    wanted = 20.0 * float(restricted_loss_ev_per_um(2500.0, limit_ev=knock_on_limit_ev(10.0)))
    assert abs(found.mean() - wanted) < 4 * found.std() / np.sqrt(20_000)


@pytest.mark.parametrize(("path_um", "count"), [(10.0, 100_000), (50.0, 40_000), (300.0, 10_000)])
def test_most_probable_loss(path_um: float, count: int) -> None:
    """Bichsel (1988): t (100.6 + 35.35 ln t) eV up to 110 um, t (190 + 16.3 ln t) beyond; within 8 %.

    300 um: also the most probable loss after Landau, Vavilov and Bichsel as the Particle Data Group prints it (eq.
    34.12), 78.6 keV for this momentum.
    """
    found = losses(path_um, count, limit_um=path_um)
    # half-sample mode of the middle: mean of the shortest interval that holds a quarter of the values
    ordered, part = np.sort(found), count // 4
    start = int(np.argmin(ordered[part:] - ordered[:-part]))
    mode = np.median(ordered[start : start + part])
    log = np.log(path_um)
    bichsel = path_um * (100.6 + 35.35 * log if path_um < 110 else 190.0 + 16.3 * log)
    assert mode == pytest.approx(bichsel, rel=0.08)
    if path_um == 300.0:
        assert mode == pytest.approx(78.6e3, rel=0.05)
