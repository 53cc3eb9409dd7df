"""The twin: a measured lens, a detector and a sensor file from the frames; frames rendered with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from calib.cameras import BrownConrady
from calib.cameras.fit import fit_to_map
from calib.records import NoiseModel, SensorImage
from experiments.twin.measure import CameraFit
from experiments.twin.night import REFERENCE_K, FieldStars
from experiments.twin.photometry import COLOUR_KNOTS, POGSON, REFERENCE_KNOT
from experiments.twin.psf import REFERENCE_CLASS, PsfModel
from optics.arrays import FloatArray
from optics.export.write import write_measured_lens
from optics.lens.measured import GaussianMixture, MeasuredLens
from optics.lens.without_glass import measured_lens
from optics.light.photometry import photon_rate
from optics.light.spectrum import Blackbody
from optics.response import Response
from render.detector.readout import expose
from render.detector.spec import Detector, load_detector
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import ExpectedImage
from render.sensor import build_star_sensor
from render.sky.star_light import star_light

WAVELENGTHS_NM = np.arange(400.0, 1001.0, 25.0)
CURVE_NM = np.array([400.0, 500.0, 600.0, 700.0, 800.0, 1000.0])
"""Knots of the curve that corrects the stated quantum efficiency until stars have the colours that were measured."""
STIFFNESS_MAG = 0.5
"""How far the correction may bend at a knot without evidence."""
PSF_NODES = (5, 4)
PSF_WAVES_NM = (500.0, 800.0)
CLASS_K = (3400.0, 4880.0, 6330.0, 10500.0)
"""Colour temperatures that stand for the classes of the PSF: means of the brightest stars (G < 7) of the sky."""
PSF_TRUST = 0.02
"""Logarithm of a width or share: what three Gaussians in four classes cannot describe."""
CORE_SLOPE, WIDTH_SLOPE = 3.0, 0.3
"""How far the logarithms of core and width may change from node to node without evidence."""
HIGHEST_TRANSMISSION = 0.9
NARROWEST_PX = 0.05
NODES = 6
WARM_PART = 0.95
"""Of the pattern that is dark current where its skewness shows."""
DETECTOR_KEYS = """
    name source chip_width_px chip_height_px prnu dark_current_e_per_s dark_reference_c dark_doubling_c
    dark_spread_e_per_s hot_fraction hot_dark_e_per_s dead_fraction full_well_e crosstalk_horizontal crosstalk_vertical
    crosstalk_diagonal read_noise_e read_noise_spread gain_dn_per_e offset_dn dsnu_e column_pattern_e adc_bits
    sensor_seed
"""
CHIP_C = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumed:
    """Properties that frames of stars do not determine, and their assumed values."""

    pixel_pitch_mm: float
    exposure_s: float
    aperture_mm: float | None = None  # None: as small as the light allows
    quantum_efficiency: str = "cmv4000"  # Detector whose curve it is, up to the measured correction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twin:
    """A camera as records."""

    lens: MeasuredLens
    detector: Detector
    exposure_s: float
    response_mag: FloatArray  # (k,) Colour term of the twin's spectral response at `COLOUR_KNOTS`


def electrons_per_mm2(response: FloatArray, colour: FloatArray) -> FloatArray:
    """Electrons (n,) per s and mm2 of aperture of stars of G = 0, colours 5040 K / T, behind a response on the grid."""
    rates = np.stack([_photons(float(REFERENCE_K / one)) for one in np.ravel(colour)])
    return np.asarray(np.trapezoid(rates * np.asarray(response, float), WAVELENGTHS_NM, axis=1))


@lru_cache(maxsize=64)
def _photons(temperature_k: float) -> FloatArray:
    """Photons s^-1 mm^-2 nm^-1 on the grid of a black body of G = 0."""
    star = Blackbody(temperature_k=temperature_k)
    return np.asarray(photon_rate(star, 0.0, wavelength_nm=WAVELENGTHS_NM, system="G"))


def spectral_response(fit: CameraFit, efficiency: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Relative response that gives stars their measured colours; colour terms; electrons of G = 0 per mm2 and s.

    The colours alone do not determine a curve: it is the stated efficiency, bent as little as the colours ask for.
    """
    known = np.isfinite(fit.photometry.colour_mag)
    wanted, error = fit.photometry.colour_mag[known], np.maximum(fit.photometry.colour_error_mag[known], 0.01)
    colours = COLOUR_KNOTS[known]
    at = int(np.flatnonzero(colours == COLOUR_KNOTS[REFERENCE_KNOT])[0])

    def curve(p: FloatArray) -> FloatArray:
        return np.asarray(efficiency * np.exp(np.interp(WAVELENGTHS_NM, CURVE_NM, p) / POGSON))

    def terms(p: FloatArray) -> FloatArray:
        light = electrons_per_mm2(curve(p), colours)
        return np.asarray(POGSON * np.log(light / light[at]))

    def misfit(p: FloatArray) -> FloatArray:
        bend = np.diff(p, 2) / STIFFNESS_MAG
        return np.concatenate([(terms(p) - wanted) / error, bend, [p.mean() / 0.1]])

    found = least_squares(misfit, np.zeros(len(CURVE_NM)))
    shape = curve(found.x)
    every = electrons_per_mm2(shape, COLOUR_KNOTS)
    reference = every[REFERENCE_KNOT]
    return shape, POGSON * np.log(every / reference), float(reference)


def build_twin(
    fit: CameraFit, assumed: Assumed, *, name: str, source: str, taken: datetime | None, saturation_dn: float, hot: int
) -> Twin:
    """Records of the camera that the frames show."""
    base = load_detector(assumed.quantum_efficiency)
    efficiency = np.interp(
        WAVELENGTHS_NM, base.quantum_efficiency.wavelength_nm, base.quantum_efficiency.value, left=0.02, right=0.01
    )
    shape, terms, light = spectral_response(fit, efficiency)
    above = fit.photometry.zero_point_above_mag
    assert above is not None
    # electrons of a star of G = 0 per exposure, over those per mm2 and s: aperture area times a factor on the response
    area_mm2 = 10.0 ** (0.4 * above.value) / (light * assumed.exposure_s)
    correction = shape / efficiency
    aperture = assumed.aperture_mm
    if aperture is None or area_mm2 * correction.max() > 0.25 * np.pi * aperture**2:
        aperture = float(np.sqrt(4.0 * area_mm2 * correction.max() / (np.pi * HIGHEST_TRANSMISSION)))
    transmission = correction * area_mm2 / (0.25 * np.pi * aperture**2)
    width, height = fit.psf.size_px
    lens = _lens(fit, assumed, aperture, transmission, shape, name=name, source=source, taken=taken)
    gain, (dsnu_e, dark_e, warm_e) = fit.noise.gain_e_per_dn, _pattern_e(fit)
    detector = Detector(
        name=f"detector of {name}",
        source=f"{source}; quantum efficiency: {base.quantum_efficiency.name}, the difference is in the lens's file",
        chip_width_px=width,
        chip_height_px=height,
        chips=1,
        gap_px=0,
        pixel_pitch_mm=assumed.pixel_pitch_mm,
        diffusion_sigma_mm=0.0,
        quantum_efficiency=Response(
            name=base.quantum_efficiency.name,
            source=base.quantum_efficiency.source,
            wavelength_nm=WAVELENGTHS_NM,
            value=efficiency,
        ),
        prnu=fit.noise.prnu,
        dark_current_e_per_s=dark_e / assumed.exposure_s,
        dark_reference_c=CHIP_C,
        dark_doubling_c=6.5,
        dark_spread_e_per_s=warm_e / assumed.exposure_s,
        hot_fraction=hot / (width * height),
        hot_dark_e_per_s=8.0
        * float(np.sqrt(fit.noise.variance_dn2(np.median(fit.noise.levels_dn))))
        * gain
        / assumed.exposure_s,
        dead_fraction=0.0,
        full_well_e=min(1.05 * saturation_dn * gain, 1e7),
        crosstalk_horizontal=0.0,
        crosstalk_vertical=0.0,
        crosstalk_diagonal=0.0,
        read_noise_e=fit.noise.read_noise_e[0],
        read_noise_spread=0.0,
        gain_dn_per_e=1.0 / gain,
        nonlinearity=(),
        offset_dn=fit.noise.black_level_dn[0],
        dsnu_e=dsnu_e,
        column_pattern_e=0.0,
        adc_bits=int(np.clip(np.ceil(np.log2(saturation_dn + 1.0)), 1, 16)),
        sensor_seed=1,
    )
    return Twin(lens=lens, detector=detector, exposure_s=assumed.exposure_s, response_mag=terms)


def _pattern_e(fit: CameraFit) -> tuple[float, float, float]:
    """DSNU [e-] as a normal distribution, or mean and spread [e-] of a dark current whose skewness was measured.

    The current is lognormal: the lightest tail with the second and third moment of the pattern. Its mean is a part of
    the sky, above which it cannot be.
    """
    noise, gain = fit.noise, fit.noise.gain_e_per_dn
    dsnu, spread = noise.dsnu_dn, WARM_PART * noise.dsnu_dn
    if noise.third_moment_dn3 > 0.0:
        skewness = noise.third_moment_dn3 / spread**3
        ratio = 2.0 * np.sinh(np.arcsinh(skewness / 2.0) / 3.0)  # c^3 + 3 c of spread over mean c
        mean = spread / ratio
        if mean < noise.levels_dn.min() - noise.black_level_dn[0]:
            return float(np.sqrt(dsnu**2 - spread**2)) * gain, float(mean) * gain, spread * gain
    return dsnu * gain, 0.0, 0.0


def _lens(
    fit: CameraFit,
    assumed: Assumed,
    aperture_mm: float,
    transmission: FloatArray,
    response: FloatArray,
    *,
    name: str,
    source: str,
    taken: datetime | None,
) -> MeasuredLens:
    camera = fit.camera
    if not isinstance(camera, BrownConrady):  # the file holds Brown-Conrady
        grid = camera.geometry.grid_px(15)
        ray = camera.unproject(grid)
        ideal = ray[:, :2] / ray[:, 2:]
        focal_px = float(np.linalg.norm(grid[-1] - grid[0]) / np.linalg.norm(ideal[-1] - ideal[0]))
        start = BrownConrady.create(camera.geometry, focal_length_mm=focal_px * camera.geometry.pixel_pitch_mm)
        camera = fit_to_map(start, ray, grid, turn=False).model
    pitch = assumed.pixel_pitch_mm
    scale = pitch / camera.geometry.pixel_pitch_mm
    value = camera.value
    radius = np.linspace(0.0, 1.0, 9)
    half_mm = 0.5 * pitch * float(np.hypot(*fit.psf.size_px))
    distortion = np.array(
        [
            value("q1_per_mm2") / scale**2,
            value("q2_per_mm4") / scale**4,
            value("q3_per_mm6") / scale**6,
            value("p1_per_mm") / scale,
            value("p2_per_mm") / scale,
        ]
    )
    focal = value("focal_length_mm") * scale
    when = taken or datetime(2000, 1, 1, tzinfo=UTC)
    return MeasuredLens(
        name=name,
        source=source,
        date=f"{when:%Y-%m-%d}" if taken else "unknown",
        focal_length_mm=focal,
        principal_point_mm=np.array([value("x0_px"), value("y0_px")]) * pitch,
        distortion=distortion,
        colour_nm=np.array(PSF_WAVES_NM),
        colour_scale=np.ones(len(PSF_WAVES_NM)),
        colour_shift_mm=np.zeros((len(PSF_WAVES_NM), 2)),
        psf=mixture(fit.psf, pitch, response),
        includes_charge_diffusion=True,
        vignetting_mm=radius * half_mm,
        relative_light=10.0 ** (-0.4 * fit.photometry.loss_at(radius**2)),
        aperture_mm=aperture_mm,
        transmission=Response(
            name=f"transmission of {name}",
            source=source,
            wavelength_nm=WAVELENGTHS_NM,
            value=np.clip(transmission, 0.0, 1.0),
        ),
        reference_wavelength_nm=600.0,
        max_field_deg=float(np.degrees(np.arctan(1.05 * half_mm / focal))),
    )


def mixture(psf: PsfModel, pitch_mm: float, response: FloatArray) -> GaussianMixture:
    """The PSF as tables: one PSF at every node of wavelength, so that the colour classes are as measured."""
    at_nodes = psf_of_wavelengths(psf, response)
    width, height = psf.size_px
    x, y = (np.linspace(0.0, n - 1.0, count) for n, count in ((width, PSF_NODES[0]), (height, PSF_NODES[1])))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    reference = np.full(len(places), REFERENCE_CLASS)
    share, along_x, along_y = (
        np.array([[part[k] for part in one.parts(places, reference)] for one in at_nodes])
        .transpose(0, 2, 1)
        .reshape(len(at_nodes), len(y), len(x), 3)
        for k in range(3)
    )
    variance = [np.maximum(one, NARROWEST_PX) ** 2 * pitch_mm**2 for one in (along_x, along_y)]
    return GaussianMixture(
        wavelength_nm=np.array(PSF_WAVES_NM),
        y_mm=(y - (height - 1.0) / 2.0) * pitch_mm,
        x_mm=(x - (width - 1.0) / 2.0) * pitch_mm,
        share=share / share.sum(axis=-1, keepdims=True),
        offset_mm=np.zeros((*share.shape, 2)),
        covariance_mm2=np.stack([*variance, np.zeros_like(share)], axis=-1),
    )


def psf_of_wavelengths(psf: PsfModel, response: FloatArray) -> list[PsfModel]:
    """A PSF (its reference class) for each node, which stars of the four classes see mixed as their spectra are.

    Core and width of a class are strongly correlated: both are fitted together, with the covariance of the PSF's fit.
    """
    rates = np.stack([_photons(one) * response for one in CLASS_K])
    hats = np.stack([np.interp(WAVELENGTHS_NM, PSF_WAVES_NM, row) for row in np.eye(len(PSF_WAVES_NM))])
    light = rates @ hats.T / rates.sum(axis=1)[:, None]  # (4, nodes) Share of a class's light that a node stands for
    known = np.array([0, 3, *np.arange(12, 18)])
    covariance = psf.covariance[np.ix_(known, known)]
    free = np.diag(covariance) > 0.0  # classes without stars have no say
    root = np.linalg.cholesky(np.linalg.inv(covariance[np.ix_(free, free)] + PSF_TRUST**2 * np.eye(int(free.sum()))))
    count, outer = len(PSF_WAVES_NM), float(np.exp(psf.value[1]))
    others = np.arange(len(CLASS_K)) != REFERENCE_CLASS

    def seen(p: FloatArray) -> FloatArray:
        """Logarithms of core over middle and of the middle's width of the classes, as the PSF holds them."""
        inner = np.exp(p[:count])
        core, middle = inner / (1.0 + inner + outer), 1.0 / (1.0 + inner + outer)
        ratio = np.log(light @ core) - np.log(light @ middle)
        width = 0.5 * np.log(light @ (middle * np.exp(2.0 * p[count:])) / (light @ middle))
        at = REFERENCE_CLASS
        return np.concatenate([[ratio[at], width[at]], (width - width[at])[others], (ratio - ratio[at])[others]])

    def misfit(p: FloatArray) -> FloatArray:
        bend = np.concatenate([np.diff(p[:count]) / CORE_SLOPE, np.diff(p[count:]) / WIDTH_SLOPE])
        return np.concatenate([root.T @ (seen(p) - psf.value[known])[free], bend])

    start = np.repeat(psf.value[[0, 3]], count)
    found = least_squares(misfit, start, bounds=(start - 3.0, start + 3.0)).x
    out = []
    for core, width in found.reshape(2, count).T:
        value = psf.value.copy()
        value[0], value[3:5] = core, psf.value[3:5] + width - psf.value[3]
        out.append(replace(psf, value=value))
    return out


def write_twin(
    twin: Twin, folder: Path, *, faintest_mag: float, window_px: int, name: str, compared: Sequence[str] = ()
) -> tuple[Path, ...]:
    """``sensor.toml``, ``lens.toml`` and ``detector.toml`` in a folder."""
    lens = write_measured_lens(twin.lens, folder / "lens.toml")
    detector, sensor = folder / "detector.toml", folder / "sensor.toml"
    chip, lines = twin.detector, []
    for key in DETECTOR_KEYS.split():
        lines.append(f"{key} = {_toml(getattr(chip, key))}")
    lines += [
        f"pixel_pitch_um = {chip.pixel_pitch_mm * 1e3:.9g}",
        f"diffusion_sigma_um = {chip.diffusion_sigma_mm * 1e3:.9g}",
    ]
    curve = chip.quantum_efficiency
    lines += ["", "[quantum_efficiency]", f"source = {_toml(curve.source)}"]
    lines += [f"wavelength_nm = {_toml(curve.wavelength_nm)}", f"value = {_toml(curve.value)}"]
    detector.write_text("\n".join(lines) + "\n", encoding="utf-8")
    text = [
        f"name = {_toml(name)}",
        'centroid = "epsf"',
        f"window_px = {window_px}",
        f"compared = [{', '.join(_toml(one) for one in compared)}]",
        "",
        "[instrument]",
        'lens = "lens.toml"',
        'detector = "detector.toml"',
        "defocus_mm = 0.0",
        "coating_nm = 0.0",
        "absorption = false",
        f"exposure_s = {twin.exposure_s:.9g}",
        f"chip_temperature_c = {CHIP_C:g}",
        "",
        "[passband]",
        "range_nm = [0.0, 0.0]",
        "",
        "[catalogue]",
        f"faintest_mag = {faintest_mag:g}",
    ]
    sensor.write_text("\n".join(text) + "\n", encoding="utf-8")
    return lens, detector, sensor


def _toml(value: object) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return "[" + ", ".join(f"{one:.6g}" for one in value) + "]"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class TwinRenderer:
    """Renders stars through the measured lens of a twin, as `observe` and ``dataset`` do."""

    def __init__(self, twin: Twin) -> None:
        lens = measured_lens(twin.lens)
        self.sensor = build_star_sensor(lens, twin.detector, coating_nm=0.0, absorption=False)
        self._renderer = StarRenderer(self.sensor.camera, exposure_s=twin.exposure_s)
        self._light = star_light([self.sensor.passband()], nodes=NODES, magnitude_system="G")
        self._dark_e = twin.detector.dark_current_e_per_s * twin.exposure_s
        self._focal_px = twin.lens.focal_length_mm / twin.detector.pixel_pitch_mm

    def electrons(
        self,
        stars: FieldStars,
        level_e: FloatArray,
        *,
        extinction_mag: float,
        scatter_mag: float,
        motion_px: float,
        rng: np.random.Generator,
    ) -> FloatArray:
        """Noiseless image (h, w) [e-] of one frame: its own sky, and the stars that the air lets through.

        Extinction is per airmass, 0 where it is in the throughput; ``scatter_mag`` and ``motion_px`` are standard
        deviations of a star's light and of its place per axis.
        """
        magnitude = stars.magnitude + scatter_mag * rng.standard_normal(len(stars))
        if extinction_mag:
            magnitude = magnitude + extinction_mag * stars.airmass
        moved = stars.direction + 0.0
        moved[:, :2] += motion_px / self._focal_px * rng.standard_normal((len(stars), 2)) * stars.direction[:, 2:]
        moved /= np.linalg.norm(moved, axis=1)[:, None]
        light = self._renderer.render(self._light.stars(moved, magnitude, stars.temperature_k))
        return np.asarray(np.maximum(level_e - self._dark_e, 0.0) + light.electrons[:, :, 0], float)


def as_image(twin: Twin, electrons: FloatArray, streams: Streams, frame: int, noise: NoiseModel) -> SensorImage:
    """Read out by the twin's detector; the noise model is the one that the real frames are reduced with."""
    expected = ExpectedImage(
        electrons=np.maximum(electrons, 0.0).astype(np.float32)[:, :, None],
        band=("open",),
        exposure_s=twin.exposure_s,
        diffused=True,
    )
    got = expose(expected, twin.detector, streams=streams, frame=frame, temperature_c=CHIP_C)
    return SensorImage(
        dn=got.dn.astype(np.float64),
        valid=np.ones(got.dn.shape, bool),
        saturated=got.saturated,
        noise=noise,
        source=f"twin {frame}",
    )
