"""Centroiders against the Cramer-Rao bound, compared with photutils and sep on the same stamps.

    python benchmarks/centroid.py [--psf NAME] [--stars N] [--peer-stars N] [--seed N]

For every PSF source: RMS position error over the bound at matched-filter SNR 20, 50, 100 and 500
(`calib.measure.centroid_error.cramer_rao_bound`), S-curve (largest position error against sub-pixel phase without
noise, constant offset removed) and time per star, the slowest of the four SNRs, best of three; CPU time is summed over
the cores and depends less on other processes. The bound is for known background, which all methods know. A constant
offset (an asymmetric PSF has no obvious centre) is taken from the noiseless S-curve and removed, for all methods alike;
the phase-dependent part stays in the RMS.

A PSF source is a function without arguments that returns a `PsfSource`; put your own into `SOURCES`, or hand a finely
sampled `EffectivePsf` (for instance a rendered one) to `source_from_fine`.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.special import ndtr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calib.measure.centroid_error.cramer_rao_bound import fisher_information, flux_for_snr
from calib.measure.centroiding.gaussian import draw_gaussian
from calib.measure.centroiding.registry import get_centroider
from calib.measure.epsf.bspline import draw_epsf
from calib.measure.epsf.build import build_epsf
from calib.measure.stamps import coarse_position
from calib.records import NoiseModel, Stamps
from render.records import EffectivePsf

SIZE = 11
SNRS = (20, 50, 100, 500)
NOISE = NoiseModel(read_noise_e=5.0)
BACKGROUND_E = 2.0
Draw = Callable[[np.ndarray, np.ndarray], np.ndarray]
Measure = Callable[[Stamps], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class PsfSource:
    """A PSF as known to the estimators (``epsf``), and true images of stars (``draw``).

    ``draw(x, y)`` gives unit stars (n, SIZE, SIZE) at columns x and rows y (n,) of the window.
    """

    name: str
    epsf: EffectivePsf
    draw: Draw


def source_from_fine(name: str, fine: EffectivePsf, oversampling: int = 8) -> PsfSource:
    """Stars drawn from a finely sampled PSF; the estimators get every k-th sample of it."""
    if fine.oversampling % oversampling:
        raise ValueError(f"{name}: oversampling {fine.oversampling} is no multiple of {oversampling}")
    k = fine.oversampling // oversampling
    centre = len(fine.values) // 2
    half = centre // k
    pick = centre + k * np.arange(-half, half + 1)
    epsf = EffectivePsf(values=fine.values[np.ix_(pick, pick)], oversampling=oversampling)
    return PsfSource(name, epsf, lambda x, y: draw_epsf(fine, x, y, (SIZE, SIZE)))


def gaussian_source(sigma_px: float, oversampling: int = 4) -> PsfSource:
    """Gaussian, integrated over pixels in closed form."""
    offset = np.arange(-8 * oversampling, 8 * oversampling + 1) / oversampling
    profile = ndtr((offset + 0.5) / sigma_px) - ndtr((offset - 0.5) / sigma_px)
    epsf = EffectivePsf(values=np.outer(profile, profile), oversampling=oversampling)
    return PsfSource(f"gauss{sigma_px:g}", epsf, lambda x, y: draw_gaussian(x, y, sigma_px, (SIZE, SIZE)))


def comatic_epsf(
    oversampling: int, radius_px: float = 1.4, coma_px: float = 0.3, diffusion_px: float = 0.3
) -> EffectivePsf:
    """Defocused disk with coma along a slanted axis, blurred by charge diffusion and integrated over pixels.

    Rays fill the pupil by Gauss-Legendre in r^2 times equal angles; every ray is a normal distribution integrated over
    the pixel in closed form, so that the only error is that of the pupil quadrature.
    """
    node, weight = np.polynomial.legendre.leggauss(48)
    radius = np.sqrt(0.5 * (node + 1.0))[:, None]
    angle = 2.0 * np.pi * (np.arange(128) + 0.5)[None, :] / 128
    along = radius_px * radius * np.cos(angle) + coma_px * radius**2 * (2.0 + np.cos(2.0 * angle))
    across = radius_px * radius * np.sin(angle) + coma_px * radius**2 * np.sin(2.0 * angle)
    light = np.broadcast_to(weight[:, None] / (2.0 * 128), along.shape).ravel()
    turn = np.deg2rad(30.0)
    x = (along * np.cos(turn) - across * np.sin(turn)).ravel()
    y = (along * np.sin(turn) + across * np.cos(turn)).ravel()
    x, y = x - light @ x, y - light @ y  # origin = centre of light
    offset = np.arange(-8 * oversampling, 8 * oversampling + 1) / oversampling

    def profile(centre: np.ndarray) -> np.ndarray:
        z = offset - centre[:, None]
        return ndtr((z + 0.5) / diffusion_px) - ndtr((z - 0.5) / diffusion_px)

    return EffectivePsf(values=(profile(y) * light[:, None]).T @ profile(x), oversampling=oversampling)


def lens_source(name: str, x_px: float, y_px: float, defocus_mm: float = 0.01) -> PsfSource:
    """Our 206 mm lens on its detector, 550 to 650 nm, rendered near pixel (x_px, y_px)."""
    from optics.lens_file import load_lens
    from optics.light.band import TopHat, band_nodes
    from optics.rays.paraxial import axial_paraxial
    from render.camera import build_camera
    from render.detector.spec import load_detector
    from render.engine import Engine
    from render.records import StarField
    from render.tracing.psf import epsf_tracer, render_epsf

    Engine.start()

    lens = load_lens("star_camera_206mm")
    camera = build_camera(lens, load_detector("acc18_mosaic"), defocus_mm=defocus_mm)
    nodes = band_nodes([TopHat(name="600", centre_nm=600.0, width_nm=100.0, edge_nm=5.0)], 12)
    rate = nodes.weight_nm * nodes.transmission
    focal_mm = axial_paraxial(lens, lens.design_wavelength_nm).efl_mm
    direction = camera.nominal_direction(x_px, y_px, float(focal_mm))
    stars = StarField(
        direction=direction[None], wavelength_nm=nodes.wavelength_nm, photon_rate=rate[None], band=nodes.name
    )
    return source_from_fine(name, render_epsf(epsf_tracer(camera), stars, oversampling=32)[0][0])


SOURCES: dict[str, Callable[[], PsfSource]] = {
    "gauss0.5": lambda: gaussian_source(0.5),
    "gauss0.7": lambda: gaussian_source(0.7),
    "gauss1.0": lambda: gaussian_source(1.0),
    "coma": lambda: source_from_fine("coma", comatic_epsf(32)),
    "lens": lambda: lens_source("lens", 2047.5, 1023.5),
    "lens-corner": lambda: lens_source("lens-corner", 3900.0, 1900.0),
}


def make_stamps(
    source: PsfSource, x: np.ndarray, y: np.ndarray, flux: float, rng: np.random.Generator | None
) -> Stamps:
    """Stamps of stars at (x, y); noiseless without ``rng``. The start is what a detection would give."""
    n = len(x)
    electrons = flux * source.draw(x, y) + BACKGROUND_E
    if rng is not None:
        electrons = rng.poisson(np.maximum(electrons, 0.0)) + rng.normal(0.0, NOISE.read_noise_e, electrons.shape)
    valid = np.ones(electrons.shape, dtype=bool)
    return Stamps(
        electrons=electrons,
        valid=valid,
        corner_px=np.zeros((n, 2), np.int64),
        background_e=np.full(n, BACKGROUND_E),
        start_px=np.column_stack(coarse_position(electrons - BACKGROUND_E, valid)),
        flags=np.zeros(n, np.uint32),
        psf_index=np.zeros(n, np.int64),
    )


def position_bound(source: PsfSource, x: np.ndarray, y: np.ndarray, flux: float) -> float:
    """Root of the mean bound on var(x) + var(y) [px], background known, derivatives by central differences."""
    h = 1e-3
    unit = source.draw(x, y)
    slopes = [
        flux * (source.draw(x + h, y) - source.draw(x - h, y)) / (2 * h),
        flux * (source.draw(x, y + h) - source.draw(x, y - h)) / (2 * h),
        unit,
    ]
    jacobian = np.stack(slopes, axis=1).reshape(len(x), 3, -1)
    expected = (flux * unit + BACKGROUND_E).reshape(len(x), -1)
    covariance = np.linalg.inv(fisher_information(jacobian, expected, NOISE))
    return float(np.sqrt(np.mean(covariance[:, 0, 0] + covariance[:, 1, 1])))


def ours(source: PsfSource, built: EffectivePsf) -> dict[str, Measure]:
    """This project's centroiders."""

    def measure(name: str, **options: Any) -> Measure:
        centroider = get_centroider(name, **options)

        def run(stamps: Stamps) -> tuple[np.ndarray, np.ndarray]:
            table = centroider.measure(stamps, NOISE)
            return table.x_px, table.y_px

        return run

    return {
        "cog 5x5": measure("cog", half_width_px=2),
        "cog 7x7": measure("cog", half_width_px=3),
        "tcog": measure("tcog"),
        "windowed": measure("windowed"),
        "gaussian": measure("gaussian"),
        "epsf": measure("epsf", epsf=source.epsf),
        "epsf, fitted background": measure("epsf", epsf=source.epsf, fit_background=True),
        "epsf built from frames": measure("epsf", epsf=built),
    }


def build_from_frames(source: PsfSource, rng: np.random.Generator) -> EffectivePsf:
    """ePSF from 25 stars of SNR 300 in 40 dithered frames, as a laboratory target on a stepping platform gives them."""
    stars, frames = 25, 40
    place = rng.uniform(-0.5, 0.5, (2, 1, stars)) + rng.uniform(-0.5, 0.5, (2, frames, 1))
    x, y = place.reshape(2, -1)
    whole_x, whole_y = np.rint(x), np.rint(y)
    centre = SIZE // 2
    unit = source.draw(np.full(1, float(centre)), np.full(1, float(centre)))[0]
    flux = flux_for_snr(unit, 300.0, BACKGROUND_E, NOISE)
    stamps = make_stamps(source, x - whole_x + centre, y - whole_y + centre, flux, rng)
    corner = np.column_stack([whole_x, whole_y]).astype(np.int64)
    stamps = replace(stamps, corner_px=corner, start_px=stamps.start_px + corner)
    solution = build_epsf(
        stamps,
        NOISE,
        star_index=np.tile(np.arange(stars), frames),
        frame_index=np.repeat(np.arange(frames), stars),
    )
    return solution.epsf


def mosaic(stamps: Stamps, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps without background side by side with empty gaps, and the (x, y) of each one's first pixel."""
    pitch, columns = SIZE + 12, 50
    rows = -(-count // columns)
    image = np.zeros((rows * pitch + 12, columns * pitch + 12))
    k = np.arange(count)
    corner_x, corner_y = (k % columns) * pitch + 12, (k // columns) * pitch + 12
    for i in range(count):
        image[corner_y[i] : corner_y[i] + SIZE, corner_x[i] : corner_x[i] + SIZE] = (
            stamps.electrons[i] - stamps.background_e[i]
        )
    return image, corner_x, corner_y


def peers(source: PsfSource) -> dict[str, Measure]:
    """photutils and sep, where installed."""
    methods: dict[str, Measure] = {}
    try:
        methods |= _photutils(source)
    except ImportError:
        Console().print("photutils is not installed; its rows are left out")
    try:
        methods |= _sep()
    except ImportError:
        Console().print("sep is not installed; its rows are left out")
    return methods


def _photutils(source: PsfSource) -> dict[str, Measure]:
    from astropy.table import Table as AstroTable
    from photutils.centroids import centroid_2dg, centroid_com
    from photutils.psf import ImagePSF, PSFPhotometry

    def deviation(stamps: Stamps) -> np.ndarray:
        return np.sqrt(np.maximum(stamps.electrons, 0.0) + NOISE.floor_e2)

    def com(stamps: Stamps) -> tuple[np.ndarray, np.ndarray]:
        return tuple(np.array([centroid_com(e - BACKGROUND_E) for e in stamps.electrons]).T)  # type: ignore[return-value]

    def gauss(stamps: Stamps) -> tuple[np.ndarray, np.ndarray]:
        pairs = zip(stamps.electrons, deviation(stamps), strict=True)
        return tuple(np.array([centroid_2dg(e - BACKGROUND_E, error=s) for e, s in pairs]).T)  # type: ignore[return-value]

    def psf(stamps: Stamps) -> tuple[np.ndarray, np.ndarray]:
        count = len(stamps)
        image, corner_x, corner_y = mosaic(stamps, count)
        error = np.full(image.shape, NOISE.read_noise_e)
        for i, sigma in enumerate(deviation(stamps)):
            error[corner_y[i] : corner_y[i] + SIZE, corner_x[i] : corner_x[i] + SIZE] = sigma
        start = AstroTable()
        start["x_init"] = corner_x + stamps.start_px[:, 0]
        start["y_init"] = corner_y + stamps.start_px[:, 1]
        start["flux_init"] = np.maximum((stamps.electrons - BACKGROUND_E).sum(axis=(1, 2)), 10.0)
        model = ImagePSF(np.array(source.epsf.values), oversampling=source.epsf.oversampling)
        table = PSFPhotometry(model, (SIZE, SIZE))(image, error=error, init_params=start)
        return np.asarray(table["x_fit"]) - corner_x, np.asarray(table["y_fit"]) - corner_y

    return {"photutils centroid_com": com, "photutils centroid_2dg": gauss, "photutils PSFPhotometry": psf}


def _sep() -> dict[str, Measure]:
    import sep

    def winpos(stamps: Stamps) -> tuple[np.ndarray, np.ndarray]:
        image, corner_x, corner_y = mosaic(stamps, len(stamps))
        x, y = corner_x + stamps.start_px[:, 0], corner_y + stamps.start_px[:, 1]
        radius, _ = sep.flux_radius(image, x, y, np.full(len(x), 5.0), 0.5, subpix=5)
        wide = np.clip(2.0 / 2.354820045 * radius, 0.5, 3.0)
        out_x, out_y, _ = sep.winpos(image, x, y, wide)
        return out_x - corner_x, out_y - corner_y

    return {"sep winpos (flux radius)": winpos}


def judge(
    source: PsfSource, measure: Measure, data: dict[int, Stamps], truth: np.ndarray, *, count: int, repeats: int
) -> dict[str, float]:
    """RMS over bound at every SNR, S-curve, time per star and stars lost, on the first ``count`` of the stamps."""
    phase = (np.arange(16) + 0.5) / 16 - 0.5
    grid_x, grid_y = (a.ravel() + SIZE // 2 for a in np.meshgrid(phase, phase))
    unit = source.draw(np.full(1, float(SIZE // 2)), np.full(1, float(SIZE // 2)))[0]
    x, y = truth[:, :count]
    out: dict[str, float] = {"lost": 0.0}
    for snr in SNRS:
        flux = flux_for_snr(unit, snr, BACKGROUND_E, NOISE)
        clean_x, clean_y = measure(make_stamps(source, grid_x, grid_y, flux, None))
        offset_x, offset_y = np.mean(clean_x - grid_x), np.mean(clean_y - grid_y)
        if snr == SNRS[-1]:
            out["s_curve"] = max(np.abs(clean_x - grid_x - offset_x).max(), np.abs(clean_y - grid_y - offset_y).max())
            out["offset"] = float(np.hypot(offset_x, offset_y))
        stamps = data[snr].select(slice(0, count))
        best = least = np.inf
        for _ in range(repeats):
            start, busy = time.perf_counter(), time.process_time()
            found_x, found_y = measure(stamps)
            best = min(best, time.perf_counter() - start)
            least = min(least, time.process_time() - busy)
        error2 = (found_x - x - offset_x) ** 2 + (found_y - y - offset_y) ** 2
        kept = np.isfinite(error2) & (error2 < 4.0)
        out["lost"] += float(np.sum(~kept))
        some = slice(0, min(count, 5000))
        out[f"ratio{snr}"] = float(np.sqrt(np.mean(error2[kept]))) / position_bound(source, x[some], y[some], flux)
        out["time_us"] = max(out.get("time_us", 0.0), best / count * 1e6)
        out["cpu_us"] = max(out.get("cpu_us", 0.0), least / count * 1e6)
    return out


def report(source: PsfSource, stars: int, peer_stars: int, seed: int) -> None:
    """One table for one PSF source."""
    title = (
        f"{source.name}: {stars} stars (peers {peer_stars}, the first of the same), {SIZE}x{SIZE} px, read noise "
        f"{NOISE.read_noise_e:g} e-, background {BACKGROUND_E:g} e-; statistical error of RMS/bound "
        f"{0.5 / np.sqrt(stars):.3f} (peers {0.5 / np.sqrt(peer_stars):.3f})"
    )
    table = Table(title=title)
    for heading in (
        "method",
        *(f"RMS/bound\nSNR {s}" for s in SNRS),
        "S-curve\n[px]",
        "offset\n[px]",
        "us/star",
        "CPU us/star",
        "lost",
    ):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    built = build_from_frames(source, np.random.default_rng([seed, 1]))
    truth = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, stars)) + SIZE // 2
    unit = source.draw(np.full(1, float(SIZE // 2)), np.full(1, float(SIZE // 2)))[0]
    data = {
        snr: make_stamps(
            source, *truth, flux_for_snr(unit, snr, BACKGROUND_E, NOISE), np.random.default_rng([seed, snr])
        )
        for snr in SNRS
    }
    jobs = [(name, m, stars, 3) for name, m in ours(source, built).items()]
    jobs += [(name, m, peer_stars, 1) for name, m in peers(source).items()]
    for name, measure, count, repeats in jobs:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the peers warn about every star whose fit is not perfect
            row = judge(source, measure, data, truth, count=count, repeats=repeats)
        ratios = [f"{row[f'ratio{s}']:.3f}" for s in SNRS]
        figures = [
            f"{row['s_curve']:.1e}",
            f"{row['offset']:.4f}",
            f"{row['time_us']:.1f}",
            f"{row['cpu_us']:.1f}",
            f"{row['lost']:.0f}",
        ]
        table.add_row(name, *ratios, *figures)
    Console(width=150).print(table)


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description="Centroiders against the Cramer-Rao bound, photutils and sep.")
    parser.add_argument("--psf", default="all", choices=[*SOURCES, "all"])
    parser.add_argument("--stars", type=int, default=20000)
    parser.add_argument("--peer-stars", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in SOURCES if options.psf == "all" else [options.psf]:
        report(SOURCES[name](), options.stars, options.peer_stars, options.seed)


if __name__ == "__main__":
    main()
