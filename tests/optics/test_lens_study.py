"""What the page of a lens says of waves, for an ideal lens, against the closed forms of an aberration-free circle."""

from pathlib import Path

import numpy as np
import pytest

from optics.lens_file import read_lens_file
from optics.lens_study import airy_radius_mm, study

IDEAL = """name = "ideal"
source = "closed form"
design_wavelength_nm = 500.0
max_field_deg = 1.0
[pupil]
f_number = 5.0
[[surface]]
stop = true
kind = "paraxial"
focal_length_mm = 50.0
thickness_mm = 50.0
medium = "air"
"""


@pytest.mark.slow
def test_an_ideal_lens_is_shown_as_one(tmp_path: Path) -> None:
    """Encircled light 1 - J0^2 - J1^2: 0.838 in the first dark ring, 0.910 in the second; Strehl ratio of defocus
    sinc^2(W / wavelength) (Born and Wolf, Principles of Optics, secs. 8.5.2 and 8.8)."""
    (tmp_path / "ideal.toml").write_text(IDEAL)
    made = study(read_lens_file(tmp_path / "ideal.toml"), "ideal.toml")
    waves = made.waves
    shot = waves.images
    assert shot.strehl == pytest.approx([1.0] * 3, abs=2e-4)
    assert max(one.rms_waves for one in waves.wavefront) < 1e-6
    assert np.abs(waves.zernike_waves).max() < 1e-6
    assert shot.intensity.max(axis=(1, 2)) == pytest.approx([1.0] * 3, abs=1e-3)
    unit_mm = 500e-6 * 5.0
    assert airy_radius_mm(made) == pytest.approx(1.22 * unit_mm)
    mtf = made.mtf
    part = mtf.frequency * unit_mm  # of the cutoff (Goodman, Introduction to Fourier Optics, sec. 6.4.2)
    assert mtf.limit[0, 1] == pytest.approx(2 / np.pi * (np.arccos(part) - part * np.sqrt(1 - part**2)), abs=1 / 256)
    assert mtf.diffraction == pytest.approx(mtf.limit, abs=1e-6)
    for ring, share in ((1.21967, 0.8378), (2.23313, 0.9099)):
        assert np.interp(ring * unit_mm, waves.radius_mm, shot.encircled[0]) == pytest.approx(share, abs=4e-3)
    defocus_waves = waves.focus_mm / (8.0 * 5.0**2) / 500e-6
    assert shot.strehl_through_focus[0] == pytest.approx(np.sinc(defocus_waves) ** 2, abs=0.02)
