"""The one ray trace on Dr.Jit arrays against the same source on NumPy arrays."""

import ctypes
import mmap
import os

import numpy as np
import pytest

from optics.arrays import NUMPY
from optics.frames import field_direction, light_direction
from optics.lens.perturb import decentre, tilt
from optics.lens_file import load_lens
from optics.rays.program import compile_lens
from optics.rays.trace import Rays, trace, trace_program
from render.engine.upload import uploaded

LENSES = ("star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm")
OTHERS = [(LENSES[0], True), (LENSES[1], False), (LENSES[2], False), (LENSES[2], True)]


def test_elementary_functions_agree_with_numpy(engine):
    xp = engine.arrays
    values = np.array([-2.0, -0.0, 0.5, 3.0])
    arrays = engine.types.Float64(values)
    assert np.array_equal(xp.sqrt(engine.types.Float64(values**2)).numpy(), NUMPY.sqrt(values**2))
    assert np.array_equal(xp.maximum(arrays, 0.25).numpy(), NUMPY.maximum(values, 0.25))
    assert np.array_equal(xp.where(arrays > 0, arrays, 7.0).numpy(), NUMPY.where(values > 0, values, 7.0))
    assert np.array_equal(xp.minimum(arrays, 0.25).numpy(), NUMPY.minimum(values, 0.25))
    index, table = xp.whole(arrays) + 2, np.arange(12.0).reshape(2, 6)
    assert np.array_equal(
        xp.take(xp.table(table), index).numpy(), NUMPY.take(NUMPY.table(table), NUMPY.whole(values) + 2)
    )
    assert xp.table(table) is xp.table(table)  # uploaded once


@pytest.mark.skipif(os.name != "posix", reason="mprotect")
def test_kernels_do_not_read_beyond_what_is_uploaded(engine):
    """Before a page that must not be read: Dr.Jit's own arrays of these 13 numbers end the process."""
    size, memory = mmap.PAGESIZE, mmap.mmap(-1, 2 * mmap.PAGESIZE)
    second = ctypes.addressof(ctypes.c_char.from_buffer(memory)) + size
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(second), ctypes.c_size_t(size), 0) == 0
    values = np.frombuffer(memory, count=13, offset=size - 13 * 8)
    values[:] = np.arange(13.0)
    assert ((uploaded(engine.types.Float64, values) + 1.0).numpy() == np.arange(1.0, 14.0)).all()


def test_parameters_keep_double_precision_and_stay_out_of_the_kernel(engine):
    import drjit as dr

    (value,) = engine.arrays.parameters([1 / 3 + 1e-15])
    assert value.numpy()[0] == 1 / 3 + 1e-15
    assert value.state == dr.VarState.Evaluated  # a literal would be compiled in


@pytest.mark.parametrize(
    ("name", "general"),
    [(LENSES[0], False), (LENSES[1], True), *(pytest.param(*one, marks=pytest.mark.slow) for one in OTHERS)],
)
def test_trace_agrees_with_numpy(engine, name, general):
    lens = load_lens(name)
    if general:
        lens = tilt(decentre(lens, lens.elements[1], x_mm=0.05), lens.elements[0], x_deg=0.1)
    rng = np.random.default_rng(5)
    count, reach = 4000, 1.3 * lens.surfaces[0].semi_diameter_mm  # some miss the apertures
    field = rng.uniform(-lens.max_field_deg, lens.max_field_deg, (2, count))
    low, high = lens.wavelength_range_nm
    rays = Rays.create(
        x_mm=rng.uniform(-reach, reach, count),
        y_mm=rng.uniform(-reach, reach, count),
        z_mm=-10.0,
        direction=light_direction(field_direction(*field)),
        wavelength_nm=rng.uniform(max(low, 450.0), min(high, 900.0), count),
    )
    expected = trace(lens, rays)
    program, theta = compile_lens(lens, general=general)
    xp = engine.arrays
    names = ("x", "y", "z", "dx", "dy", "dz", "wavelength_nm", "opl_mm")
    columns = {key: engine.types.Float64(np.ascontiguousarray(getattr(rays, key))) for key in names}
    integers = {"status": engine.types.Int32(rays.status), "failed_at": engine.types.Int32(rays.failed_at)}
    got = trace_program(program, xp.parameters(theta.tolist()), Rays(**columns, **integers), xp)
    assert np.array_equal(got.status.numpy(), expected.status)
    assert np.array_equal(got.failed_at.numpy(), expected.failed_at)
    ok = expected.ok
    assert 0.1 < ok.mean() < 0.9
    for key in ("x", "y", "dx", "dy", "dz", "opl_mm"):
        assert np.abs(getattr(got, key).numpy() - getattr(expected, key))[ok].max() < 2e-12 * max(
            1.0, np.abs(getattr(expected, key)[ok]).max()
        )
