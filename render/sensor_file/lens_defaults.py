"""Settings taken from the lens file of a design program, for experiments without own settings.

Aperture, fields and design wavelength are part of the lens: its stop, its half field, the wavelength of its first
order. Here are two settings of the rest of a star sensor: the pass band, from the shortest to the longest wavelength of
the file, and the window of the detector that the half field fills.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, isfinite
from typing import TYPE_CHECKING, Any

from optics.errors import StarbenchError
from render.sensor_file.tables import in_focus

if TYPE_CHECKING:
    from optics.lens_file import LensFile
    from render.sensor_file.tables import InstrumentConfig, PassbandConfig

STEP_PX = 4
"""Unit of the width of windows [px]."""


def _of_program(lens: Any) -> LensFile | None:
    """The lens file, if it is one of a design program; unreadable files are reported where needed."""
    from optics.files.read import SUFFIXES, split_configuration

    if not isinstance(lens, str) or not split_configuration(lens)[0].lower().endswith(SUFFIXES):
        return None
    from optics.lens_file import read_lens_file

    try:
        return read_lens_file(lens)
    except StarbenchError:
        return None


def _range_nm(file: LensFile) -> tuple[float, float] | None:
    """Shortest and longest wavelength that the file gives a weight; None for one colour."""
    if file.defaults is None:
        return None
    used = file.defaults.wavelength_nm[file.defaults.wavelength_weight > 0.0]
    return (float(used.min()), float(used.max())) if used.size > 1 else None


def _window_px(file: LensFile, detector: Any) -> tuple[int, int] | None:
    """Window that sees the fields of the file, where a chip sees more; None where it does not, or for several chips."""
    from optics.rays.chief_ray import chief_ray_points
    from render.detector.spec import load_detector

    lens = file.lens
    try:
        chip = load_detector(detector)
        x_mm, _ = chief_ray_points(lens, [0.0, lens.max_field_deg], 0.0, blocked="follow")
    except StarbenchError:
        return None
    corner = hypot(chip.width_px, chip.height_px) * chip.pixel_pitch_mm / 2.0
    fraction = abs(float(x_mm[1] - x_mm[0])) / corner
    if chip.chips > 1 or not isfinite(fraction) or fraction >= 1.0:
        return None
    width, height = (int(fraction * n) // STEP_PX * STEP_PX for n in (chip.width_px, chip.height_px))
    return (width, height) if min(width, height) > 0 else None


def lens_defaults(values: Mapping[str, Any], usual: Any = "star_camera_206mm") -> dict[str, Any]:
    """Settings determined by the instrument's lens where not stated.

    Another lens than the ``usual`` one, whose focus is among the defaults, stands in its best focus.
    """
    instrument, passband = values.get("instrument"), values.get("passband")
    if isinstance(instrument, Mapping) and in_focus(instrument.get("lens")):
        return {"instrument": {"defocus_mm": 0.0}}
    if not isinstance(instrument, Mapping):
        return {}
    defaults: dict[str, Any] = {} if instrument.get("lens") == usual else {"instrument": {"defocus_mm": "best"}}
    file = _of_program(instrument.get("lens"))
    if file is None:
        return defaults
    band = _range_nm(file)
    if isinstance(passband, Mapping) and band is not None and band[1] - band[0] > passband.get("edge_nm", 0.0):
        defaults["passband"] = {"range_nm": band}
    if not (instrument.get("width_px") or instrument.get("height_px")):
        window = _window_px(file, instrument.get("detector"))
        if window is not None:
            defaults["instrument"] = {**defaults.get("instrument", {}), "width_px": window[0], "height_px": window[1]}
    return defaults


def lens_remarks(instrument: InstrumentConfig, passband: PassbandConfig | None) -> tuple[str, ...]:
    """Settings that an experiment took from the lens file of its instrument, in words; nothing for a lens of our own
    format."""
    file = _of_program(instrument.lens)
    if file is None or file.report is None or file.defaults is None:
        return ()
    from optics.rays.paraxial import axial_paraxial

    lens = file.lens
    taken = [f"the design wavelength, {lens.design_wavelength_nm:g} nm", f"the half field, {lens.max_field_deg:.4g}°"]
    try:
        f_number = axial_paraxial(lens, lens.design_wavelength_nm).f_number
        if instrument.f_number is None and isfinite(f_number):
            taken.insert(0, f"the aperture, F/{f_number:.4g}")
    except StarbenchError:
        pass
    band = _range_nm(file)
    if passband is not None and not passband.file and band == passband.range_nm:
        taken.append(f"the pass band, {band[0]:g} to {band[1]:g} nm, of its wavelengths")
    if (instrument.width_px, instrument.height_px) == _window_px(file, instrument.detector):
        taken.append(f"the window of {instrument.width_px} × {instrument.height_px} px that its field fills")
    if file.defaults.vignetting.any():
        taken.append("its vignetting factors, as rims where it states none")
    words = f"From {file.report.file}: {'; '.join(taken)}."
    inexact = len(file.report.inexact)
    if inexact:
        words += f" {inexact} of its commands are not in the lens exactly (`starbench lens show` names them)."
    return (words,)
