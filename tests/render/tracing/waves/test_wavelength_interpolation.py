"""Few wavelengths in place of many: functions that polynomials tell are kept, in every band as many."""

import numpy as np
import pytest

from render.tracing.waves.wavelength_interpolation import condensed_light


def test_few_wavelengths_sum_smooth_functions_as_all_of_them_do():
    """Bands of unlike widths ask for unlike numbers; no wavelength comes twice, which outlines could not tell apart."""
    wave = np.stack([np.linspace(450.0, 550.0, 16), np.linspace(600.0, 800.0, 16), np.linspace(700.0, 720.0, 16)])
    share = np.random.default_rng(3).dirichlet(np.ones(32), (4, 3))  # two times
    few, found = condensed_light(wave, share, 0.0)
    assert few.shape[1] < 12
    assert (np.diff(few) > 0.0).all()
    ours = np.cos(few / 60.0) * found.reshape(4, 3, 2, -1).transpose(2, 0, 1, 3)
    theirs = np.cos(wave / 60.0) * share.reshape(4, 3, 2, -1).transpose(2, 0, 1, 3)
    assert ours.sum(-1) == pytest.approx(theirs.sum(-1), abs=1e-5)


def test_lines_without_width_are_left_alone():
    wave, share = np.full((1, 1), 600.0), np.ones((2, 1, 1))
    few, found = condensed_light(wave, share, 0.0)
    assert few is wave
    assert found is share
