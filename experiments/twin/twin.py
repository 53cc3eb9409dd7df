"""The twin of a camera: measured lens, detector, sensor file, and frames rendered with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calib.detector.sky_photon_transfer import lognormal_dark
from calib.photometry.spectral_response import WAVELENGTHS_NM
from calib.psf.measured_lens import lens_from_stars
from calib.records import NoiseModel, SensorImage
from experiments.twin.measure import CameraFit
from experiments.twin.night import FieldStars
from optics.arrays import FloatArray
from optics.export.write import toml_lens, write_measured_lens
from optics.lens.ideal_lens import measured_lens
from optics.lens.measured import MeasuredLens
from optics.response import Response
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams
from render.sensor import build_star_sensor
from render.simulator import SkySimulator

CHIP_C, BAND = 0.0, "open"
HOT_SIGMA = 8.0
"""Dark current of a hot pixel over the noise at the median background."""
DETECTOR_KEYS = """
    name source chip_width_px chip_height_px prnu dark_current_e_per_s dark_reference_c dark_doubling_c
    dark_spread_e_per_s hot_fraction hot_dark_e_per_s dead_fraction full_well_e crosstalk_horizontal crosstalk_vertical
    crosstalk_diagonal read_noise_e read_noise_spread gain_dn_per_e offset_dn dsnu_e column_pattern_e adc_bits
    sensor_seed
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumedCamera:
    """Assumed values of properties that frames of stars do not determine."""

    pixel_pitch_mm: float
    exposure_s: float
    saturation_dn: float
    aperture_mm: float | None = None  # None: as small as the light allows
    quantum_efficiency: str = "cmv4000"  # Detector with this curve, before the measured colour correction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twin:
    """Measured lens and detector of a camera."""

    lens: MeasuredLens
    detector: Detector
    exposure_s: float
    response_mag: FloatArray  # (k,) Colour term of the twin's spectral response at the knots


def build_twin(
    fit: CameraFit,
    assumed: AssumedCamera,
    *,
    name: str = "twin",
    source: str = "night frames",
    taken: datetime | None = None,
    hot_fraction: float = 0.0,
) -> Twin:
    """Twin of a measured camera."""
    base = load_detector(assumed.quantum_efficiency).quantum_efficiency
    efficiency = np.interp(WAVELENGTHS_NM, base.wavelength_nm, base.value, left=0.02, right=0.01)
    lens, response_mag = lens_from_stars(
        fit.camera,
        fit.psf,
        fit.photometry,
        pitch_mm=assumed.pixel_pitch_mm,
        exposure_s=assumed.exposure_s,
        efficiency=efficiency,
        aperture_mm=assumed.aperture_mm,
        name=name,
        source=source,
        date=f"{taken:%Y-%m-%d}" if taken else "unknown",
    )
    noise, (width, height) = fit.noise, fit.psf.size_px
    gain = noise.gain_e_per_dn
    rate = gain / assumed.exposure_s
    dsnu_dn, dark_dn, warm_dn = lognormal_dark(noise)
    background_dn = float(np.sqrt(noise.variance_dn2(np.median(noise.levels_dn))))
    detector = Detector(
        name=f"detector of {name}",
        source=f"{source}; quantum efficiency: {base.name}, the difference is in the lens's file",
        chip_width_px=width,
        chip_height_px=height,
        chips=1,
        gap_px=0,
        pixel_pitch_mm=assumed.pixel_pitch_mm,
        diffusion_sigma_mm=0.0,
        quantum_efficiency=Response(name=base.name, source=base.source, wavelength_nm=WAVELENGTHS_NM, value=efficiency),
        prnu=noise.prnu,
        dark_current_e_per_s=dark_dn * rate,
        dark_reference_c=CHIP_C,
        dark_doubling_c=6.5,
        dark_spread_e_per_s=warm_dn * rate,
        hot_fraction=hot_fraction,
        hot_dark_e_per_s=HOT_SIGMA * background_dn * rate,
        dead_fraction=0.0,
        full_well_e=min(1.05 * assumed.saturation_dn * gain, 1e7),
        crosstalk_horizontal=0.0,
        crosstalk_vertical=0.0,
        crosstalk_diagonal=0.0,
        read_noise_e=noise.read_noise_e[0],
        read_noise_spread=0.0,
        gain_dn_per_e=1.0 / gain,
        nonlinearity=(),
        offset_dn=noise.black_level_dn[0],
        dsnu_e=dsnu_dn * gain,
        column_pattern_e=0.0,
        adc_bits=min(max(int(assumed.saturation_dn).bit_length(), 1), 16),
        sensor_seed=1,
    )
    return Twin(lens=lens, detector=detector, exposure_s=assumed.exposure_s, response_mag=response_mag)


def write_twin(
    twin: Twin, folder: Path, *, faintest_mag: float, window_px: int, name: str, compared: Sequence[str] = ()
) -> tuple[Path, ...]:
    """``sensor.toml``, ``lens.toml`` and ``detector.toml`` in a folder."""
    lens = write_measured_lens(twin.lens, folder / "lens.toml")
    detector, sensor = folder / "detector.toml", folder / "sensor.toml"
    chip, curve = twin.detector, twin.detector.quantum_efficiency
    efficiency = {
        "source": curve.source,
        "wavelength_nm": curve.wavelength_nm.tolist(),
        "value": curve.value.tolist(),
    }
    keys = {key: getattr(chip, key) for key in DETECTOR_KEYS.split()}
    keys |= {"pixel_pitch_um": chip.pixel_pitch_mm * 1e3, "diffusion_sigma_um": chip.diffusion_sigma_mm * 1e3}
    detector.write_text(toml_lens({**keys, "quantum_efficiency": efficiency}), encoding="utf-8")
    instrument = {
        "lens": lens.name,
        "detector": detector.name,
        "defocus_mm": 0.0,
        "coating_nm": 0.0,
        "absorption": False,
        "exposure_s": twin.exposure_s,
        "chip_temperature_c": CHIP_C,
    }
    tables = {
        "name": name,
        "centroid": "epsf",
        "window_px": window_px,
        "compared": list(compared),
        "instrument": instrument,
        "passband": {"range_nm": [0.0, 0.0]},
        "catalogue": {"faintest_mag": faintest_mag},
    }
    sensor.write_text(toml_lens(tables), encoding="utf-8")
    return lens, detector, sensor


class TwinRenderer:
    """Renders stars through the measured lens of a twin, as `observe` and ``dataset`` do."""

    def __init__(self, twin: Twin) -> None:
        self.sensor = build_star_sensor(measured_lens(twin.lens), twin.detector, coating_nm=0.0, absorption=False)
        self._simulator = SkySimulator(self.sensor, exposure_s=twin.exposure_s, temperature_c=CHIP_C)
        self._dark_e = twin.detector.dark_current_e_per_s * twin.exposure_s
        self._focal_px = twin.lens.focal_length_mm / twin.detector.pixel_pitch_mm

    def frame(
        self,
        stars: FieldStars,
        sky_e: FloatArray,
        *,
        extinction_mag: float,
        scatter_mag: float,
        motion_px: float,
        streams: Streams,
        number: int,
        noise: NoiseModel,
    ) -> SensorImage:
        """Image (h, w) of stars behind the atmosphere on a background ``sky_e``.

        ``scatter_mag`` and ``motion_px`` are standard deviations of a star's flux and of its position per axis,
        ``noise`` is the noise model for the reduction.
        """
        rng = streams.generator("stars", number)
        magnitude = stars.magnitude + scatter_mag * rng.standard_normal(len(stars))
        if extinction_mag:
            magnitude = magnitude + extinction_mag * stars.airmass
        direction = stars.direction + 0.0
        direction[:, :2] += motion_px / self._focal_px * rng.standard_normal((len(stars), 2)) * stars.direction[:, 2:]
        direction /= np.sqrt((direction**2).sum(axis=1))[:, None]
        field = self._simulator.light.stars(direction, magnitude, stars.temperature_k)
        light = self._simulator.expected(Rotation.identity(), stars=field)
        sky_e = np.maximum(sky_e - self._dark_e, 0.0)
        frame = self._simulator.read(light, frame=number, label=BAND, added_e=sky_e, streams=streams)
        return SensorImage(
            dn=frame.dn.astype(np.float64),
            valid=np.ones(frame.dn.shape, bool),
            saturated=frame.saturated,
            noise=noise,
            source=f"twin {number}",
        )
