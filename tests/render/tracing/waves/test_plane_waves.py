"""Rays between few traced ones against the rays themselves."""

from dataclasses import fields

import numpy as np
import pytest

from render.tracing.pupil.outlines import rings
from render.tracing.waves.plane_waves import PlaneWaves, WaveSeries

FEW, MANY, TURN = (12, 40), (30, 112), 0.3


def waves_of(order, bump=0.0, turn=TURN):
    """Plane waves of a pupil with defocus, coma, spherical aberration, and perhaps a narrow bump."""
    ring, weight = rings(order[0])
    angle = 2.0 * np.pi / order[1] * (np.arange(order[1]) + turn)
    r, phi = (v.ravel() for v in np.meshgrid(ring, angle, indexing="ij"))
    u, v = r * np.cos(phi), r * np.sin(phi)
    bumped = np.exp(-((u - 0.4) ** 2 + v**2) / 0.02)
    phase = 0.7 * r**2 + 0.4 * r**2 * u + 0.3 * r**4 + bump * bumped
    share = np.repeat(weight, order[1]) / order[1]
    arrays = {"x": 100.0 + 0.4 * u, "y": 50.0 + 0.4 * v, "fx": 1.4 * u, "fy": 1.4 * v + 20.0, "weight": share}
    arrays["turns"] = 3e4 + phase - 1.4 * u * (100.0 - arrays["x"]) - arrays["fy"] * (50.0 - arrays["y"])
    arrays["amplitude"] = share * (1.0 + 0.1 * u)
    return PlaneWaves(
        **{name: v[None, None, None] for name, v in arrays.items()}, lost=np.zeros((1, 1, 1)), clear=np.ones((1, 1, 1))
    )


def field_at(rays, x, y):
    """Sum of the plane waves of some rays at places [px]."""
    x0, y0, fx, fy, turns, amplitude = rays
    turned = turns + fx * (x[:, None] - x0) + fy * (y[:, None] - y0)
    return np.exp(2j * np.pi * (turned - turns[0])) @ amplitude


def test_series_of_few_rays_make_the_sum_of_many():
    series = WaveSeries.of(waves_of(FEW), FEW, np.full((1, FEW[0]), TURN))
    assert series.resolved.all()
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    x, y = 100.0 + np.linspace(0.0, 9.0, 40) * np.cos(5 * angle), 50.0 + np.linspace(0.0, 9.0, 40) * np.sin(5 * angle)
    ours = field_at(series.rays((0, 0), MANY, 0), x, y)
    theirs = field_at(waves_of((48, 200), turn=0.0).rays((0, 0), 0), x, y)
    assert np.abs(ours) == pytest.approx(np.abs(theirs), abs=3e-6 * np.abs(theirs).max())
    assert len(series.rays((0, 0), MANY, 0)[0]) < 0.8 * np.prod(MANY)


def test_what_series_do_not_hold_is_found_out():
    waves = waves_of(FEW, bump=0.05)
    assert not WaveSeries.of(waves, FEW, np.full((1, FEW[0]), TURN)).resolved.any()
    dark = PlaneWaves(**{one.name: getattr(waves_of(FEW), one.name).copy() for one in fields(PlaneWaves)})
    for values in (dark.weight, dark.amplitude):
        values[..., 17] = 0.0
    assert not WaveSeries.of(dark, FEW, np.full((1, FEW[0]), TURN)).resolved.any()
