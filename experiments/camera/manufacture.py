"""Manufactured lenses: sampled within the tolerances, refocused, and traced.

Spots, light and distortion of every lens follow by rays. Its noise-equivalent angle is the nominal sensor's times the
ratio of two predictions, of this lens and of the nominal one, from spots by rays blurred by diffraction as a Gaussian
(up to 12 % off for fast lenses, as rendered frames show); the attitude follows from this noise for the stars that the
nominal sensor detects.

Before calibration, the distortion is the error of the design's map after a common shift, roll and, with the focus,
scale; after calibration, the residual of a cubic polynomial added to that map for each lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.accuracy.attitude_forecast import with_noise_scaled
from calib.accuracy.distortion import map_change_px, polynomial_rms_px
from calib.measure.centroid_error.prediction import predict_centroids
from experiments.camera.settings import CameraReportConfig
from experiments.harness.drawings import bars
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.lens.system import LensSystem
from optics.lens.tolerances import Tolerances, draw_amounts, perturbations, perturbed
from optics.rays.polychromatic_spots import PolychromaticSpots, polychromatic_spots
from optics.units import UM_MM
from render.engine.random import Streams
from render.sensor_file.file import ManufactureConfig

GRID = (7, 5)
"""Field points, columns x rows, within `GRID_FRACTION` of the half sides of the detector."""
GRID_FRACTION = 0.95
"""Outermost field points, in half sides of the detector."""
NEA_POINTS = (8, 12, 22, 26)
"""Field points near the Gauss points of the quadrants, whose mean is that over the detector."""
PERCENTILES = (50, 90, 95, 99)
"""Fractions of the lenses in the table of errors."""
LABELS = {
    "nea": "NEA",
    "attitude_cross": "Attitude across, median",
    "lsfe_before": "Distortion, not calibrated",
    "lsfe_after": "Distortion, calibrated",
}
RANKS = (0.1, 0.5, 0.9)
"""Ranks of the rendered lenses in the order of their NEA."""
OFFENDERS = 8
"""Listed tolerances."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manufactured:
    """Distribution of the errors (one standard deviation) of manufactured lenses, and sensitivities to tolerances."""

    lenses: int = col("Lenses that were traced")
    failed_lenses: int = col("Lenses without an image")
    yield_fraction: float = col(
        "Fraction of lenses that meets the nea, attitude_cross, spot and lsfe requirements", "", ".3f"
    )
    error_arcsec: FloatArray = col("Not exceeded by this fraction of lenses", "arcsec", ".3f", "built percentile")
    nominal_arcsec: FloatArray = col("Nominal", "arcsec", ".3f", "built")
    spot_px: FloatArray = col(
        "Largest spot radius, not exceeded by this fraction of lenses", "px", ".3f", "percentile", shown=False
    )
    distortion_rms_arcsec: float = col("Distortion not calibrated, RMS of the lenses", "arcsec", ".3f")
    distortion_rss_arcsec: float = col("Distortion not calibrated, by sensitivities", "arcsec", ".3f")
    offender_distortion_arcsec: FloatArray = col("Distortion not calibrated per 1σ", "arcsec", ".3f", "offender")
    offender_spot_um2: FloatArray = col("Growth of the squared spot radius per 1σ", "um²", ".3f", "offender")
    offenders: tuple[str, ...]
    ranked: tuple[tuple[LensSystem, float], ...]  # Lenses at `RANKS` in focus, and NEA over the nominal one


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedLens:
    """A manufactured lens in rendered frames."""

    rank_percent: float = col("Lenses with less noise", "percent", ".0f")
    measured_arcsec: Measured = col("NEA in frames", "arcsec", ".3f")
    predicted_arcsec: float = col("predicted", "arcsec", ".3f")


class _Probe:
    """Traces lenses at the field points of the nominal lens, and evaluates their errors against it."""

    def __init__(self, prediction: CameraPrediction, *, refocused: bool) -> None:
        state, camera = prediction.state, prediction.state.sensor.camera
        self.prediction, self.refocused, self.pitch_mm = prediction, refocused, camera.pixel_pitch_mm
        self.pixel_arcsec = state.pixel_arcsec
        x, y = (np.linspace(-GRID_FRACTION, GRID_FRACTION, n) for n in GRID)
        self.position = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self.offset_px = self.position * [camera.width_px / 2, camera.height_px / 2]
        self.field_deg = field_angles_deg(state.sensor.direction_at(*(self.offset_px + camera.centre_px).T))
        self.nominal = self.trace(camera.focused_lens, refocused=False)

    def trace(self, lens: LensSystem, *, refocused: bool | None = None, shift_mm: float = 0.0) -> PolychromaticSpots:
        """Spots of a lens in its best focus (``refocused``, by default as configured) plus ``shift_mm``."""
        state, refocused = self.prediction.state, self.refocused if refocused is None else refocused
        return polychromatic_spots(
            lens, *self.field_deg, state.light.wavelength_nm[0], state.fraction, refocused=refocused, shift_mm=shift_mm
        )

    def nea_px(self, images: PolychromaticSpots) -> float:
        """Centroid noise of the quoted star."""
        prediction, frame = self.prediction, self.prediction.processing.frame
        relative_light = images.light_mm2.mean() / self.nominal.light_mm2.mean()
        errors = predict_centroids(
            "epsf",
            prediction.state.blurred_psfs(images, NEA_POINTS),
            np.array([prediction.axis_e * relative_light]),
            noise=frame.noise,
            background_e=frame.background_e,
            window_px=prediction.config.window_px,
            phases=4,  # two phases would miss the middle of the pixel, where the noise of a sharp spot is largest
        )
        return float(np.sqrt((errors.noise_px**2).mean()))

    def map_change(self, images: PolychromaticSpots, reference: PolychromaticSpots) -> float:
        """Distortion [arcsec] relative to another lens after shift, roll and, if refocused, scale."""
        change_px = (images.position_mm - reference.position_mm) / self.pitch_mm
        return self.pixel_arcsec * map_change_px(self.offset_px, change_px * [1.0, -1.0], scaled=self.refocused)

    def calibrated(self, images: PolychromaticSpots) -> float:
        """Distortion [arcsec] after a fitted cubic polynomial."""
        return self.pixel_arcsec * polynomial_rms_px(self.position / GRID_FRACTION, images.position_mm / self.pitch_mm)

    def spot_px(self, images: PolychromaticSpots) -> float:
        """Largest RMS radius of a spot."""
        return float(np.sqrt(images.square_mm2.max())) / self.pitch_mm


def tolerances_of(config: ManufactureConfig) -> Tolerances:
    """Tolerances of the table ``[manufacture]``."""
    return Tolerances(
        decentre_mm=config.decentre_um * UM_MM,
        tilt_deg=config.tilt_arcmin / 60.0,
        wedge_deg=config.wedge_arcmin / 60.0,
        thickness_mm=config.thickness_um * UM_MM,
        radius_fraction=config.radius_percent / 100.0,
        index=config.index,
    )


def manufactured(
    prediction: CameraPrediction, limits: dict[str, tuple[float, bool]], *, advance: Callable[[], None] = lambda: None
) -> Manufactured:
    """Sample lenses and trace them.

    Raises
    ------
    DomainError
        If fewer than two lenses have an image.
    """
    config: CameraReportConfig = prediction.config
    setting = config.manufacture
    lens = prediction.state.sensor.camera.focused_lens
    lens.check_surfaces()
    probe = _Probe(prediction, refocused=setting.refocused)
    moves = perturbations(lens, tolerances_of(setting))
    rng = Streams(config.seed).generator("manufacture")
    traced: list[tuple[LensSystem, PolychromaticSpots]] = []
    # the last amount is the residual defocus
    for amounts in draw_amounts(rng, setting.lenses, len(moves) + 1, uniform=setting.distribution == "uniform"):
        try:
            sampled = perturbed(lens, moves, amounts[:-1])
            traced.append((sampled, probe.trace(sampled, shift_mm=float(amounts[-1]) * setting.focus_um * UM_MM)))
        except (ConvergenceError, DomainError):
            pass
        advance()
    if len(traced) < 2:
        raise DomainError(
            f"{len(traced)} of {setting.lenses} lenses form an image; lower the tolerances of [manufacture]"
        )
    spots = [lens_spots for _, lens_spots in traced]
    ratio = np.array([probe.nea_px(images) for images in spots]) / probe.nea_px(probe.nominal)
    nominal_nea_arcsec = prediction.value("nea_arcsec")
    noise_arcsec = prediction.value("attitude_cross_noise_arcsec")
    total_arcsec = prediction.value("attitude_cross_arcsec")
    lsfe_before_arcsec = np.array([probe.map_change(images, probe.nominal) for images in spots])
    spot_px = np.array([probe.spot_px(images) for images in spots])
    errors_arcsec = {  # in the order of `LABELS`
        "nea_arcsec": nominal_nea_arcsec * ratio,
        "attitude_cross_arcsec": np.asarray(with_noise_scaled(total_arcsec, noise_arcsec, ratio)),
        "lsfe_before_arcsec": lsfe_before_arcsec,
        "lsfe_after_arcsec": np.array([probe.calibrated(images) for images in spots]),
    }
    met = [values <= limits[key][0] for key, values in (errors_arcsec | {"spot_px": spot_px}).items() if key in limits]
    by_noise = np.argsort(ratio)
    ranked = by_noise[np.rint(np.array(RANKS) * (len(traced) - 1)).astype(int)]
    return Manufactured(
        lenses=len(traced),
        failed_lenses=setting.lenses - len(traced),
        yield_fraction=float(np.all([np.ones(len(traced), bool), *met], axis=0).sum() / setting.lenses),
        error_arcsec=np.percentile(list(errors_arcsec.values()), PERCENTILES, axis=1).T,
        nominal_arcsec=np.array([nominal_nea_arcsec, total_arcsec, 0.0, probe.calibrated(probe.nominal)]),
        spot_px=np.percentile(spot_px, PERCENTILES),
        distortion_rms_arcsec=float(np.sqrt((lsfe_before_arcsec**2).mean())),
        ranked=tuple((_at_detector(*traced[k]), float(ratio[k])) for k in ranked),
        **_offenders(probe, lens, moves),
    )


def _offenders(probe: _Probe, lens: LensSystem, moves: dict[str, Any]) -> dict[str, Any]:
    """Sensitivities to all tolerances by central differences; the largest listed."""
    reference = probe.trace(lens)
    pairs = [[probe.trace(move(lens, sign)) for sign in (1.0, -1.0)] for move in moves.values()]
    distortion_arcsec = np.array([0.5 * probe.map_change(plus, minus) for plus, minus in pairs])
    growth_mm2 = np.array(
        [(0.5 * (plus.square_mm2 + minus.square_mm2) - reference.square_mm2).mean() for plus, minus in pairs]
    )
    # by the sum of both effects, each relative to its largest
    relative = growth_mm2 / growth_mm2.max(initial=1e-36) + distortion_arcsec / distortion_arcsec.max(initial=1e-30)
    order = np.argsort(-relative)[:OFFENDERS]
    return {
        "distortion_rss_arcsec": float(np.sqrt((distortion_arcsec**2).sum())),
        "offender_distortion_arcsec": distortion_arcsec[order],
        "offender_spot_um2": growth_mm2[order] * 1e6,
        "offenders": tuple(np.array(list(moves), dtype=object)[order]),
    }


def yield_line(result: Manufactured) -> str:
    """Line on the yield for the terminal."""
    nea_arcsec = result.error_arcsec[0, PERCENTILES.index(95)]
    sampled = result.lenses + result.failed_lenses
    met = f"{100.0 * result.yield_fraction:.3g} % of {sampled} lenses meet their requirements"
    return f"{'Yield':<19} {met}; NEA of 95 %: {nea_arcsec:.3g}\u2033"


def _at_detector(lens: LensSystem, images: PolychromaticSpots) -> LensSystem:
    return replace(lens, image_position_mm=lens.image_position_mm + images.shift_mm * lens.image_rotation[:, 2])


def _axes(q: Quantities, result: Manufactured) -> None:
    q.axis("built", list(LABELS), "Error", names=list(LABELS.values()))
    q.axis("percentile", [str(p) for p in PERCENTILES], "Fraction of the lenses", names=[f"{p} %" for p in PERCENTILES])
    q.axis("offender", np.array(result.offenders, dtype=object), "Tolerance, one standard deviation")


MANUFACTURED = Section(
    record=Manufactured,
    axes=_axes,
    rows="built",
    across="percentile",
    columns="nominal_arcsec error_arcsec",
    caption="Manufactured lenses: value not exceeded by the stated fraction of lenses; one standard deviation.",
    figures={"offenders": bars("offender", bars="offender_distortion_arcsec", aspect_ratio=0.5)},
)
RENDERED_LENSES = Section(
    record=RenderedLens,
    dim="rank",
    rows="rank",
    hidden="rank",
    caption="Three manufactured lenses in rendered frames: NEA of artificial stars, one axis, 1σ.",
)
