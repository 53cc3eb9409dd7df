"""Calibration of star cameras under a rendered sky: from frames to the map of the line of sight, and its parts.

Frames are rendered and measured in `experiments.skycal.measure`, matched in `experiments.skycal.match`, calibrated in
`experiments.skycal.calibrate`. Results common to all cameras have the dimension ``camera``; results whose size differs
between cameras (models, parameters, points of the map, stars) have a section per camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from experiments.harness.drawings import arrows, curves
from experiments.harness.progress import Progress
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, agree, below, col, ratio_near
from experiments.harness.summary import Measured
from experiments.skycal.calibrate import METHODS, PARTS, CalibratedCamera, CalibratedMap, calibrate_camera, rms
from experiments.skycal.match import OUTCOMES, match_frames
from experiments.skycal.measure import record
from experiments.skycal.positions import STEPS
from experiments.skycal.scene import CameraScene, build_scene
from experiments.skycal.settings import CAMERAS, SkycalConfig, model_label
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.fits.files import write_frame

DATA = {"measured": "as measured", "corrected": "star colours known"}
"""Centroids that calibrate: with a PSF of one colour; with the PSF of the star's colour, colour shift subtracted."""
METHOD_NAMES = {
    "free": "free attitudes",
    "acc": "ACC, gyro taken as perfect",
    "linked": "gyro of stated noise",
    "acc_true": "ACC with a truly perfect gyro",
}
PART_NAMES = {
    "mismatch": "camera model",
    "chromatic": "star colours",
    "noise": "noise and pixels",
    "psf": "PSF of one colour",
}
PAIRS = [", ".join(pair) for pair in combinations(PARTS, 2)]
MAX_WRONG_MATCH_FRACTION = 1e-3
"""Largest fraction of wrong matches that passes."""
SCATTER_QUANTILE, NORMAL_QUANTILE, QUANTILE_ERROR = 0.8, 1.2816, 0.889
"""Robust scale: 80 % of normal deviates are below 1.2816 sigma in magnitude; the relative error of this scale is
0.889 / sqrt(n), that of the median 1.17 / sqrt(n)."""
FAINT_SNR = 50.0
"""Signal-to-noise ratio below which noise, not the pixel response, dominates the error of a centroid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraResult:
    """A camera, its stars, and the parts of its map error."""

    calibrated: CalibratedCamera
    lens: str = col("Lens", shown=False)
    detector: str = col("Detector", shown=False)
    field_deg: Sequence[float] = col("Field", "deg", ".1f", "side")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", shown=False)
    sky: str = col("Sky", shown=False)
    attribution: str = col("Source", shown=False)
    frames: int = col("Frames", shown=False)
    camera_model: str = col("Camera model", shown=False)
    detections: Sequence[int] = col("Detections", dims="outcome")
    rendered: int = col("Rendered", shown=False)
    frames_matched: int = col("Frames matched", shown=False)
    stars: int = col("Used", shown=False)
    stars_per_frame: float = col("Used per frame", "", ".0f", shown=False)
    wrong_matches: int = col("Wrong matches", shown=False)
    wrong_match_fraction: float = col("Wrong matches, fraction", shown=False)
    centroid_floor_px: Sequence[float] = col("Error beyond noise", "px", ".3f", "data")
    centroid_scatter_ratio: Measured = col("Scatter of faint stars over the stated one", shown=False)
    not_converged: int = col("Calibrations that did not converge", shown=False)
    part_rms_arcsec: Sequence[float] = col("RMS", "arcsec", "#.2g", "part")
    quadrature_arcsec: float = col("Root sum square", "arcsec", ".4f")
    part_correlation: Sequence[float] = col("Correlation", "", "+.2f", "pair")


def summarise_camera(calibrated: CalibratedCamera) -> CameraResult:
    """Camera and stars, wrong matches, scatter of centroids, and RMS and correlation of the parts of the map error."""
    scene = calibrated.scene
    matched = calibrated.matched
    used = calibrated.used
    part = calibrated.part_arcsec
    part_rms = {name: rms(error) for name, error in part.items()}
    judged_fits = [calibrated.of(data, method=method) for data in DATA for method in ("free", "linked")]
    return CameraResult(
        calibrated=calibrated,
        lens=scene.instrument.camera.lens.name,
        detector=scene.instrument.detector.name,
        field_deg=scene.instrument.field_deg,
        pixel_arcsec=scene.pixel_arcsec,
        sky=f"Gaia DR3 and Hipparcos to G = {scene.config.faintest_mag:g}",
        attribution=scene.sky.catalog.attribution,
        frames=scene.frames,
        camera_model=scene.config.model,
        detections=list(matched.count.values()),
        rendered=sum(len(frame.star) for frame in calibrated.recording.frames),
        frames_matched=matched.first_matched,
        stars=int(used.sum()),
        stars_per_frame=float(used.sum()) / scene.frames,
        wrong_matches=int((~matched.correct).sum()),
        wrong_match_fraction=float((~matched.correct).mean()),
        centroid_floor_px=list(calibrated.floor_px.values()),
        centroid_scatter_ratio=centroid_scatter_ratio(calibrated),
        not_converged=sum(fitted.calibration.solution.status != "converged" for fitted in judged_fits),
        part_rms_arcsec=list(part_rms.values()),
        quadrature_arcsec=float(np.sqrt(sum(value**2 for value in part_rms.values()))),
        part_correlation=[
            float(np.nanmean((part[a] * part[b]).sum(axis=1)) / (part_rms[a] * part_rms[b]))
            for a, b in combinations(PARTS, 2)
        ],
    )


def centroid_scatter_ratio(calibrated: CalibratedCamera) -> Measured:
    """Robust scatter of faint stars' centroids (PSF of their own colour) about their light, over the stated one."""
    faint = calibrated.used & (calibrated.matched.snr < FAINT_SNR)
    if not faint.any():
        return Measured(value=float("nan"), uncertainty=float("inf"), n=0)
    error = (calibrated.position_px["star_psf"] - calibrated.position_px["light"])[faint]
    pull = error / np.sqrt(np.diagonal(calibrated.matched.covariance_px2[faint], axis1=1, axis2=2))
    scatter = float(np.quantile(np.abs(pull), SCATTER_QUANTILE)) / NORMAL_QUANTILE
    return Measured(value=scatter, uncertainty=QUANTILE_ERROR / np.sqrt(pull.size), n=pull.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapError:
    """Line of sight of the calibrated cameras against the traced lens, for a treatment of attitudes."""

    measured_rms_arcsec: Sequence[float] = col("Measured", "arcsec", ".4f", "camera")
    measured_predicted_arcsec: Sequence[Measured] = col("Predicted", "arcsec", dims="camera")
    corrected_rms_arcsec: Sequence[float] = col("Colours known", "arcsec", ".4f", "camera")
    noise_map_rms_arcsec: Sequence[float] = col("Noise only", "arcsec", ".4f", "camera")
    corrected_predicted_arcsec: Sequence[Measured] = col("Predicted", "arcsec", dims="camera")
    corrected_sigma_f_um: Sequence[float] = col("σ of f", "um", ".3f", "camera")
    corrected_reduced_chi2: Sequence[float] = col("χ² per degree", "", ".2f", "camera")


def compare_maps(cameras: Sequence[CalibratedCamera], method: str) -> MapError:
    """Map errors of all cameras by a method; "noise only" is without the misfit of the camera model."""
    measured, corrected = ([camera.of(data, method=method) for camera in cameras] for data in DATA)
    return MapError(
        measured_rms_arcsec=[fitted.rms_arcsec for fitted in measured],
        measured_predicted_arcsec=[predicted_rms(fitted) for fitted in measured],
        corrected_rms_arcsec=[fitted.rms_arcsec for fitted in corrected],
        corrected_predicted_arcsec=[predicted_rms(fitted) for fitted in corrected],
        noise_map_rms_arcsec=[
            rms(fitted.error_arcsec - camera.corrected_model_error.error_arcsec)
            for fitted, camera in zip(corrected, cameras, strict=True)
        ],
        corrected_sigma_f_um=[sigma_f_um(fitted) for fitted in corrected],
        corrected_reduced_chi2=[fitted.calibration.solution.reduced_chi2 for fitted in corrected],
    )


def predicted_rms(fitted: CalibratedMap) -> Measured:
    """Map error [arcsec] and its scatter, from the covariance of the calibration."""
    return Measured(value=fitted.map.predicted_rms_arcsec, uncertainty=fitted.map.predicted_rms_spread_arcsec)


def sigma_f_um(fitted: CalibratedMap) -> float:
    """Standard deviation of the focal length; NaN for a model without one."""
    solution = fitted.calibration.solution
    return 1e3 * float(dict(zip(solution.names, solution.sigma, strict=True)).get("focal_length_mm", np.nan))


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelError:
    """RMS map errors of a camera model; all models are fitted to the same stars."""

    parameters: int = col("Free parameters")
    direct_arcsec: float = col("Fitted to the lens", "arcsec", ".2g")
    mismatch_arcsec: float = col("Noiseless stars", "arcsec", ".2g")
    corrected_predicted_arcsec: float = col("Noise, predicted", "arcsec", ".4f")
    measured_arcsec: float = col("Measured", "arcsec", ".4f")
    corrected_arcsec: float = col("Colours known", "arcsec", ".4f")
    measured_predicted_arcsec: float = col("Predicted", "arcsec", ".4f", shown=False)
    status: str = col("Status", shown=False)


def compare_models(calibrated: CalibratedCamera) -> list[ModelError]:
    """Errors of every camera model that is compared."""
    errors = []
    for name in calibrated.scene.config.models:
        measured, corrected = (calibrated.of(data, model=name) for data in DATA)
        errors.append(
            ModelError(
                parameters=len(measured.calibration.solution.names),
                direct_arcsec=calibrated.direct[name].rms_arcsec,
                mismatch_arcsec=calibrated.of("reference", model=name).rms_arcsec,
                corrected_predicted_arcsec=corrected.map.predicted_rms_arcsec,
                measured_arcsec=measured.rms_arcsec,
                corrected_arcsec=corrected.rms_arcsec,
                measured_predicted_arcsec=measured.map.predicted_rms_arcsec,
                status=measured.calibration.solution.status,
            )
        )
    return errors


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedParameter:
    """Parameter of the configured model; ideal to distorted, in mm from the principal point."""

    name: str = col("Parameter")
    value: Measured = col("Value")


def tabulate_parameters(calibrated: CalibratedCamera) -> list[FittedParameter]:
    """Parameters and standard deviations from the calibration of measured centroids with free attitudes."""
    solution = calibrated.of("measured").calibration.solution
    stars = int(calibrated.used.sum())
    units = f"{{{calibrated.scene.name}_parameter}}"  # units along the dimension, from `parameter_axis`
    return [
        FittedParameter(name=name, value=Measured(value=float(value), unit=units, uncertainty=float(sigma), n=stars))
        for name, value, sigma in zip(solution.names, solution.value, solution.sigma, strict=True)
    ]


def parameter_axis(name: str) -> Callable[[Quantities, Sequence[FittedParameter]], None]:
    """Describes the dimension of a camera's parameters, whose names end in their units."""

    def unit(name: str) -> str:
        return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]

    def describe(q: Quantities, rows: Sequence[FittedParameter]) -> None:
        names = [parameter.name for parameter in rows]
        q.axis(f"{name}_parameter", names, "Parameter", units=[unit(parameter) for parameter in names])

    return describe


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPoint:
    """Line-of-sight error at a point of the detector, model minus traced lens; its prediction and its parts."""

    position_px: FloatArray = col("Position", "px", dims="axis")
    error_arcsec: FloatArray = col("As measured", "arcsec", dims="axis")
    sigma_arcsec: FloatArray = col("Predicted σ", "arcsec", dims="axis")
    corrected_error_arcsec: FloatArray = col("Colours known", "arcsec", dims="axis")
    corrected_sigma_arcsec: FloatArray = col("Predicted σ, colours known", "arcsec", dims="axis")
    mismatch_arcsec: FloatArray = col("Camera model", "arcsec", dims="axis")
    chromatic_arcsec: FloatArray = col("Star colours", "arcsec", dims="axis")
    noise_arcsec: FloatArray = col("Noise and pixels", "arcsec", dims="axis")
    psf_arcsec: FloatArray = col("PSF of one colour", "arcsec", dims="axis")


def tabulate_map(calibrated: CalibratedCamera) -> list[MapPoint]:
    """The map of the line of sight, row by row."""
    measured, corrected = (calibrated.of(data) for data in DATA)
    columns = {
        "position_px": calibrated.chart.pixel_px,
        "error_arcsec": measured.error_arcsec,
        "sigma_arcsec": measured.map.predicted_sigma_arcsec,
        "corrected_error_arcsec": corrected.error_arcsec,
        "corrected_sigma_arcsec": corrected.map.predicted_sigma_arcsec,
        **{f"{part}_arcsec": error for part, error in calibrated.part_arcsec.items()},
    }
    return _records(MapPoint, columns)


def _records(record: type, columns: Mapping[str, Any]) -> list[Any]:
    """Records from the columns of a table."""
    return [record(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationStar:
    """A star of the calibration."""

    frame: int = col("Frame")
    id: int = col("Star")
    magnitude: float = col("G", "mag")
    temperature: float = col("Colour temperature", "K")
    snr: float = col("Signal-to-noise ratio")
    measured_px: FloatArray = col("PSF of one colour", "px", dims="axis")
    star_psf_px: FloatArray = col("PSF of the star's colour", "px", dims="axis")
    light_px: FloatArray = col("Mean of all light", "px", dims="axis")
    reference_px: FloatArray = col("Light of the reference colour", "px", dims="axis")
    residual_px: FloatArray = col("Measured minus calibrated camera", "px", dims="axis")
    sigma_px: FloatArray = col("Stated σ", "px", dims="axis")


def tabulate_stars(calibrated: CalibratedCamera) -> list[CalibrationStar]:
    """Every star of the calibration."""
    matched = calibrated.matched
    used = calibrated.used
    sky = calibrated.scene.sky
    star = matched.star[used]
    columns: dict[str, Any] = {
        "frame": matched.frame[used],
        "id": sky.id[star],
        "magnitude": sky.magnitude[star],
        "temperature": sky.temperature_k[star],
        "snr": matched.snr[used],
        **{f"{kind}_px": calibrated.position_px[kind][used] for kind in STEPS},
        "residual_px": calibrated.residual_px,
        "sigma_px": np.sqrt(np.diagonal(matched.covariance_px2[used], axis1=1, axis2=2)),
    }
    return _records(CalibrationStar, columns)


def run(config: SkycalConfig, *, progress: Progress) -> dict[str, Any]:
    """Render, read out, measure, match, calibrate and compare."""
    root = Streams(config.seed).child("skycal")
    scenes = {name: build_scene(name, config, root.child(name)) for name in config.cameras}
    cameras = {name: calibrated_camera(scene, config, root.child(name), progress) for name, scene in scenes.items()}
    result: dict[str, Any] = {
        "cameras": [summarise_camera(camera) for camera in cameras.values()],
        "methods": [compare_maps(list(cameras.values()), method) for method in METHODS],
    }
    for name, camera in cameras.items():
        result |= {
            f"{name}_models": compare_models(camera),
            f"{name}_parameters": tabulate_parameters(camera),
            f"{name}_map": tabulate_map(camera),
            f"{name}_stars": tabulate_stars(camera),
        }
    return result


def calibrated_camera(
    scene: CameraScene, config: SkycalConfig, streams: Streams, progress: Progress
) -> CalibratedCamera:
    """Frames, matches and calibrations of a camera."""
    with progress.stage(f"{scene.name}: frames", total=scene.frames) as stage:
        recording = record(scene, config, streams, advance=stage.advance)
    with progress.stage(f"{scene.name}: matches"):
        matched = match_frames(scene, recording, config)
    with progress.stage(f"{scene.name}: calibrations", total=len(scene.config.models) + 2) as stage:
        return calibrate_camera(scene, recording, matched, config, advance=stage.advance)


def files(result: Mapping[str, Any], folder: Path) -> None:
    """A frame of each camera as FITS."""
    for camera in result["cameras"]:
        write_frame(camera.calibrated.recording.example, folder / f"frame_{camera.calibrated.scene.name}.fits")


def axes(config: SkycalConfig) -> Quantities:
    """Dimensions that several sections share."""
    q = Quantities()
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("method", METHODS, "Attitudes", names=METHOD_NAMES)
    q.axis("data", list(DATA), "Centroids", names=DATA)
    q.axis("part", PARTS, "Part", names=PART_NAMES)
    q.axis("pair", PAIRS, "Parts")
    q.axis("outcome", OUTCOMES, "Detections")
    for name, camera in config.cameras.items():
        q.axis(f"{name}_model", camera.models, "Model", names=[model_label(model) for model in camera.models])
    return q


def camera_axis(q: Quantities, rows: Sequence[CameraResult]) -> None:
    """Cameras are labelled by their focal length."""
    scenes = [camera.calibrated.scene for camera in rows]
    focal_mm = [scene.instrument.focal_length_mm for scene in scenes]
    names = [f"{f:.0f} mm" if f >= 100 else f"{f:.1f} mm" for f in focal_mm]
    q.axis("camera", [scene.name for scene in scenes], "Lens", names=names)


def sections_of(name: str) -> dict[str, Section]:
    """Sections of a camera."""
    model = f"{name}_model"
    return {
        f"{name}_models": Section(
            record=ModelError,
            dim=model,
            table=f"models_{name}",
            caption="RMS map error by camera model.",
            note="Noiseless stars: the measured stars and weights, at the positions of light of the reference colour. "
            "Noise: predicted, with known star colours.",
            figures={
                f"{name}_model_curves": curves(
                    model,
                    points="measured_arcsec corrected_arcsec",
                    lines="mismatch_arcsec corrected_predicted_arcsec",
                    log="y",
                    y="Map error, RMS",
                    aspect_ratio=0.36,
                )
            },
        ),
        f"{name}_parameters": Section(
            record=FittedParameter,
            dim=f"{name}_parameter",
            along="name",
            axes=parameter_axis(name),
            table=f"parameters_{name}",
            caption="Parameters of the calibration, with the standard deviations it states.",
        ),
        f"{name}_map": Section(
            record=MapPoint,
            dim=f"{name}_point",
            table=f"map_{name}",
            across="axis",
            hidden=f"{name}_point",
            caption="Line-of-sight error over the detector: model minus traced lens.",
            figures={f"{name}_map": arrows("position_px", "error_arcsec", "corrected_error_arcsec")},
        ),
        f"{name}_stars": Section(
            record=CalibrationStar,
            dim=f"{name}_star",
            table=f"stars_{name}",
            across="axis",
            hidden=f"{name}_star",
            caption="Stars used in the calibration.",
        ),
    }


SECTIONS: dict[str, Section] = {
    "cameras": Section(
        record=CameraResult,
        dim="camera",
        axes=camera_axis,
        table="parts",
        rows="camera",
        across="part",
        where={"method": "free"},
        columns="part_rms_arcsec quadrature_arcsec measured_rms_arcsec",
        caption="Contributions to the map error: RMS of each part, switched on successively in the same data.",
        note="Parts add up as vectors; independent parts would add in quadrature.",
        verdicts=[
            below(
                "wrong_match_fraction",
                MAX_WRONG_MATCH_FRACTION,
                title="fraction of wrong matches, largest of the cameras",
            ),
            below(
                "not_converged",
                0.0,
                title="calibrations from poor start values that did not converge, of 4 per camera",
                advice="set start.focal_ratio nearer to 1",
            ),
            ratio_near(
                "centroid_scatter_ratio",
                within=0.03,
                each="camera",
                title="scatter of faint stars' centroids over the stated one",
                advice="pixel noise differs from the detector's data",
            ),
        ],
    ),
    "methods": Section(
        record=MapError,
        dim="method",
        rows="camera method",
        columns="measured_rms_arcsec measured_predicted_arcsec corrected_rms_arcsec noise_map_rms_arcsec "
        "corrected_predicted_arcsec corrected_sigma_f_um corrected_reduced_chi2",
        caption="Line of sight of the calibrated cameras against the traced lens, RMS after the best rotation.",
        note="Colours known: centroids with the PSF of each star's colour, colour shift subtracted; "
        "noise only: without the error of the camera model. Predicted: from the covariance of the calibration, "
        "± its standard deviation. χ² well above 1: the gyro is less accurate than the method assumes.",
        verdicts=[
            agree(
                "noise_map_rms_arcsec",
                with_="corrected_predicted_arcsec",
                at={"method": "free"},
                title="map error by noise against its prediction",
                advice="residuals depend on position or frame: a wrong camera model, or a drifting attitude",
            )
        ],
    ),
}
for _name in CAMERAS:
    SECTIONS |= sections_of(_name)
