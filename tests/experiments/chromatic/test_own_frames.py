"""Reduction of own frames behind filters, from drawn centroids in place of files."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from experiments.chromatic import own_frames

FILTERS_NM, SIGMA_PX, WEDGE_PX = (500.0, 600.0, 800.0), 0.01, np.array([0.06, 0.0])
POINTS = np.stack(np.meshgrid([-20.0, 0.0, 20.0], [-20.0, 0.0, 20.0]), -1).reshape(-1, 2)


def series(rng, place, nm, *, angle_deg=0.0, light=None):
    """Nine points behind a filter; the last filter has a wedge that turns with it."""
    turn = np.exp(1j * np.radians(angle_deg)) * complex(*WEDGE_PX) * (nm == FILTERS_NM[-1])
    mean = 500.0 + 100.0 * place + POINTS + [turn.real, turn.imag]
    mean = mean + SIGMA_PX / np.sqrt(10) * rng.standard_normal(mean.shape)
    axis = np.arange(13) - 6.0
    spot = np.exp(-np.add.outer(axis**2, axis**2) / (2.0 * (nm / 500.0) ** 2))
    return SimpleNamespace(
        name=f"{place} {nm:g}",
        settings=SimpleNamespace(place=f"p{place}", filter_nm=nm, angle_deg=angle_deg),
        points=SimpleNamespace(mean_px=lambda _: mean),
        predicted_px=lambda _: np.full(mean.shape, SIGMA_PX),
        frames=10,
        pattern_px=np.zeros((9, 2, 13, 13)),
        light_per_s=light or 10.0 * nm,
        mean_e=np.stack([1e4 * spot] * 9),
    )


def reduced(monkeypatch, every, **settings):
    monkeypatch.setattr(own_frames, "reduce_series", lambda _, one, __: one)
    frames = SimpleNamespace(reference_nm=None, pixel_arcsec=5.5, **settings)
    folder = SimpleNamespace(series=every, settings=frames, centre_px=np.array([500.0, 500.0]))
    config = SimpleNamespace(filters=SimpleNamespace(reference_nm=600.0))
    return own_frames.reduce_filters(folder, ("cog",), config)[1]


def test_a_wedge_is_told_from_the_lens_by_filters_that_were_turned(monkeypatch):
    rng = np.random.default_rng(3)
    every = [series(rng, p, nm, angle_deg=180.0 * (p % 2)) for p in range(4) for nm in FILTERS_NM]
    found = reduced(monkeypatch, every)
    assert [one.pair_name for one in found["pairs"]] == ["600-500", "800-600"]
    # turned by half a circle at half of the places, it vanishes in Table 1
    for entry in found["pairs"][1].table1_px:
        assert entry.value == pytest.approx(0.0, abs=4.0 * entry.uncertainty)
        assert entry.uncertainty == pytest.approx(SIGMA_PX * np.sqrt(2.0 / 10 / 36) / 2.0)
    wedge = found["constants"][1].wedge_px
    assert [one.value for one in wedge] == pytest.approx(WEDGE_PX, abs=4.0 * wedge[0].uncertainty)
    assert [one.separated_text for one in found["constants"]] == ["yes", "yes"]
    assert found["exchange"].exchanged == 0
    still = [series(rng, 0, nm) for nm in FILTERS_NM]
    found = reduced(monkeypatch, still)
    assert found["exchange"] is None
    assert found["constants"][0].separated_text.startswith("no: neither")


def test_exchanged_files_are_named(monkeypatch):
    rng = np.random.default_rng(4)
    every = [series(rng, p, nm) for p in range(4) for nm in FILTERS_NM]
    first, second = every[6], every[7]
    first.light_per_s, second.light_per_s = second.light_per_s, first.light_per_s
    first.mean_e, second.mean_e = second.mean_e, first.mean_e
    (said,) = reduced(monkeypatch, every)["exchange"].descriptions
    assert said.startswith("the files of 500 and 600 nm at place 'p2' (light of 600 over 500 nm is 0.833 there, 1.2")
