"""The rendered aperture-mask sun sensor against geometry."""

import numpy as np
import pytest

from render.bench.sensor import MaskSensor, mask_scene, trace_mask

SIZE = 48


def sensor(**changes):
    settings = {"width_px": 1024, "height_px": 1024, "pitch_mm": 0.007, "hole_mm": 0.2, "gap_mm": 3.0}
    return MaskSensor(**(settings | {"offset_px": np.array([5.3, -7.1])} | changes))


def windows(of, sun, log2_particles=13):
    v = np.asarray(sun, float)
    v = v / np.linalg.norm(v, axis=1)[:, None]
    corner = np.rint(of.spot_px(v)).astype(int) - SIZE // 2
    light = trace_mask(
        mask_scene(of), of, v, corner, SIZE, half_angle_rad=4.4e-4, log2_particles=log2_particles, seed=1
    )
    return light, corner, v


def centres(light, corner):
    row, column = np.mgrid[:SIZE, :SIZE]
    total = light.sum((1, 2))
    return np.column_stack([(light * column).sum((1, 2)), (light * row).sum((1, 2))]) / total[:, None] + corner


def test_spots_fall_where_geometry_puts_them(engine):
    of = sensor()
    light, corner, v = windows(of, [[0, 0, 1], [0.5, 0, 1], [0, -0.8, 1], [0.9, 0.7, 1], [-1, 0.4, 1]])
    expected = np.array([511.5, 511.5]) + [5.3, -7.1] + 3.0 / 0.007 * v[:, :2] / v[:, 2:]
    assert centres(light, corner) == pytest.approx(expected, abs=0.015)


def test_light_through_the_hole(engine):
    """Flux: area of the hole times the cosine; in the middle of the spot the irradiance of the slanted beam."""
    light, _, v = windows(sensor(), [[0, 0, 1], [0.6, 0.2, 1]], log2_particles=14)
    area_px = np.pi * 0.1**2 / 0.007**2
    assert light.sum((1, 2)) == pytest.approx(area_px * v[:, 2], rel=1e-3)
    assert light[:, 20:28, 20:28].mean((1, 2)) == pytest.approx(v[:, 2], rel=0.02)
