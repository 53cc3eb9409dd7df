"""A measured wavefront in the sensor file."""

import numpy as np
import pytest

from optics.errors import ConfigError, DomainError
from optics.waves.pupil_field import trace_pupil
from optics.waves.wavefront import wavefront
from render.sensor_file.instrument import configured_lens
from render.sensor_file.tables import InstrumentConfig


def rms_nm(**settings):
    lens = configured_lens(InstrumentConfig(defocus_mm=0.0, **settings))
    found = wavefront(trace_pupil(lens, [0.0], [0.0], [lens.design_wavelength_nm], order=(12, 32)))
    return found.zernike_nm(11)[5]


def test_coefficients_and_a_map_of_them(tmp_path):
    """Sixth of Noll's polynomials: sqrt(6) (x^2 - y^2)."""
    x, y = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33))
    np.save(tmp_path / "map.npy", 50.0 * np.sqrt(6.0) * (x**2 - y**2))
    nominal = rms_nm()
    assert rms_nm(wavefront_zernike_nm=(0, 0, 0, 0, 0, 50.0)) - nominal == pytest.approx(50.0, abs=0.2)
    assert rms_nm(wavefront_map=str(tmp_path / "map.npy")) - nominal == pytest.approx(50.0, abs=0.2)


def test_what_an_interferometer_masks_is_refused(tmp_path):
    values = np.zeros((9, 9))
    values[0, 2] = np.nan
    np.savetxt(tmp_path / "map.txt", values)
    with pytest.raises(DomainError, match=r"instrument.wavefront_map = .*map.txt: .*not finite, the first at row 0"):
        configured_lens(InstrumentConfig(wavefront_map=str(tmp_path / "map.txt")))
    with pytest.raises(ConfigError, match="map cannot be read"):
        configured_lens(InstrumentConfig(wavefront_map=str(tmp_path / "none.npy")))
    with pytest.raises(ValueError, match="finite number"):
        InstrumentConfig(wavefront_zernike_nm=(0.0, float("nan")))
    with pytest.raises(ValueError, match="give one of them"):
        InstrumentConfig(wavefront_map="m.npy", wavefront_zernike_nm=(1.0,))
