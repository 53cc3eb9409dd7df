"""Calibration of star cameras under a rendered sky: from frames to the map of the line of sight, and its parts.

Frames are rendered and measured in `experiments.skycal.measure`, matched in `experiments.skycal.match`, calibrated in
`experiments.skycal.calibrate`. Results common to all cameras have the dimension ``camera``; results whose size differs
between cameras (models, parameters, places of the map, stars) have one section per camera.
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
from experiments.skycal.scene import Scene, build_scene
from experiments.skycal.settings import CAMERAS, Config, model_label
from optics.arrays import FloatArray
from render.engine.random import Streams
from render.fits.files import write_frame

DATA = {"measured": "as measured", "corrected": "star colours known"}
"""Centroids that cameras are calibrated with: of one PSF; of the star's own PSF, its colour shift taken off."""
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
PAIRS = [f"{one}, {other}" for one, other in combinations(PARTS, 2)]
WRONG_LIMIT = 1e-3
"""Part of the matches that may be wrong."""
FAINT_SNR = 50.0
"""Signal-to-noise ratio below which noise rules a centroid, not pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A camera, its stars, and the parts of its map error."""

    made: CalibratedCamera
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
    wrong_part: float = col("Wrong matches, part", shown=False)
    centroid_floor_px: Sequence[float] = col("Error beyond noise", "px", ".3f", "data")
    centroid_pull: Measured = col("Scatter of faint stars over the stated one", shown=False)
    not_converged: int = col("Calibrations that did not converge", shown=False)
    part_rms_arcsec: Sequence[float] = col("RMS", "arcsec", "#.2g", "part")
    quadrature_arcsec: float = col("Root sum square", "arcsec", ".4f")
    part_correlation: Sequence[float] = col("Correlation", "", "+.2f", "pair")


def camera(made: CalibratedCamera) -> Camera:
    """Record of a calibrated camera."""
    scene, matched, used = made.scene, made.matched, made.used
    part = made.part_arcsec
    size = {name: rms(error) for name, error in part.items()}
    judged = [made.of(data, method=method) for data in DATA for method in ("free", "linked")]
    return Camera(
        made=made,
        lens=scene.instrument.camera.lens.name,
        detector=scene.instrument.detector.name,
        field_deg=scene.instrument.field_deg,
        pixel_arcsec=scene.pixel_arcsec,
        sky=f"Gaia DR3 and Hipparcos to G = {scene.config.faintest_mag:g}",
        attribution=scene.sky.catalog.attribution,
        frames=scene.frames,
        camera_model=scene.config.model,
        detections=list(matched.count.values()),
        rendered=sum(len(one.star) for one in made.recording.frames),
        frames_matched=matched.first_matched,
        stars=int(used.sum()),
        stars_per_frame=float(used.sum()) / scene.frames,
        wrong_matches=int((~matched.correct).sum()),
        wrong_part=float((~matched.correct).mean()),
        centroid_floor_px=list(made.floor_px.values()),
        centroid_pull=centroid_pull(made),
        not_converged=sum(one.calibration.solution.status != "converged" for one in judged),
        part_rms_arcsec=list(size.values()),
        quadrature_arcsec=float(np.sqrt(sum(one**2 for one in size.values()))),
        part_correlation=[
            float(np.nanmean((part[one] * part[other]).sum(axis=1)) / (size[one] * size[other]))
            for one, other in combinations(PARTS, 2)
        ],
    )


def centroid_pull(made: CalibratedCamera) -> Measured:
    """Robust scatter of faint stars' centroids (PSF of their own colour) about their light, over the stated one."""
    faint = made.used & (made.matched.snr < FAINT_SNR)
    if not faint.any():
        return Measured(value=float("nan"), uncertainty=float("inf"), n=0)
    error = (made.position_px["own"] - made.position_px["light"])[faint]
    pull = error / np.sqrt(np.diagonal(made.matched.covariance_px2[faint], axis1=1, axis2=2))
    # 80 % of normal deviates are below 1.2816: known to 0.889 / sqrt(n) of the scale, the median to 1.17 / sqrt(n)
    scatter = float(np.quantile(np.abs(pull), 0.8)) / 1.2816
    return Measured(value=scatter, uncertainty=0.889 / np.sqrt(pull.size), n=pull.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapError:
    """Line of sight of the calibrated cameras against the traced lens, by camera, for one way to treat attitudes."""

    measured_rms_arcsec: Sequence[float] = col("Measured", "arcsec", ".4f", "camera")
    measured_predicted_arcsec: Sequence[Measured] = col(
        "Predicted",
        "arcsec",
        dims="camera",
    )
    corrected_rms_arcsec: Sequence[float] = col("Colours known", "arcsec", ".4f", "camera")
    noise_map_rms_arcsec: Sequence[float] = col("Noise only", "arcsec", ".4f", "camera")
    corrected_predicted_arcsec: Sequence[Measured] = col(
        "Predicted",
        "arcsec",
        dims="camera",
    )
    corrected_sigma_f_um: Sequence[float] = col("σ of f", "um", ".3f", "camera")
    corrected_reduced_chi2: Sequence[float] = col("χ² per degree", "", ".2f", "camera")


def map_error(made: Sequence[CalibratedCamera], method: str) -> MapError:
    """Map errors of all cameras by one method; "noise only" is without what the camera model cannot describe."""

    def each(data: str, part: Callable[[CalibratedMap], Any]) -> list[Any]:
        return [part(one.of(data, method=method)) for one in made]

    values: dict[str, Any] = {
        f"{data}_{name}": each(data, part)
        for data in DATA
        for name, part in (
            ("rms_arcsec", lambda m: m.rms_arcsec),
            (
                "predicted_arcsec",
                lambda m: Measured(
                    value=m.map.predicted_rms_arcsec, unit="arcsec", uncertainty=m.map.predicted_rms_spread_arcsec
                ),
            ),
        )
    }
    return MapError(
        noise_map_rms_arcsec=[
            rms(one.of("corrected", method=method).error_arcsec - one.clean.error_arcsec) for one in made
        ],
        corrected_sigma_f_um=each("corrected", sigma_f_um),
        corrected_reduced_chi2=each("corrected", lambda m: m.calibration.solution.reduced_chi2),
        **values,
    )


def sigma_f_um(fitted: CalibratedMap) -> float:
    """Standard deviation of the focal length; NaN for a model without one."""
    solution = fitted.calibration.solution
    return 1e3 * float(dict(zip(solution.names, solution.sigma, strict=True)).get("focal_length_mm", np.nan))


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """A camera model fitted to the same stars as the others; map errors, RMS."""

    parameters: int = col("Free parameters")
    direct_arcsec: float = col("Fitted to the lens", "arcsec", ".2g")
    mismatch_arcsec: float = col("Noiseless stars", "arcsec", ".2g")
    predicted_arcsec: float = col("Noise, predicted", "arcsec", ".4f")
    measured_arcsec: float = col("Measured", "arcsec", ".4f")
    corrected_arcsec: float = col("Colours known", "arcsec", ".4f")
    measured_predicted_arcsec: float = col("Predicted", "arcsec", ".4f", shown=False)
    status: str = col("Status", shown=False)


def models(made: CalibratedCamera) -> list[Model]:
    """Every camera model that is compared."""
    rows = []
    for name in made.scene.config.models:
        measured, corrected = (made.of(data, model=name) for data in DATA)
        rows.append(
            Model(
                parameters=len(measured.calibration.solution.names),
                direct_arcsec=made.direct[name].rms_arcsec,
                mismatch_arcsec=made.of("reference", model=name).rms_arcsec,
                predicted_arcsec=corrected.map.predicted_rms_arcsec,
                measured_arcsec=measured.rms_arcsec,
                corrected_arcsec=corrected.rms_arcsec,
                measured_predicted_arcsec=measured.map.predicted_rms_arcsec,
                status=measured.calibration.solution.status,
            )
        )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """Parameter of the configured model; ideal to distorted, in mm from the principal point."""

    name: str = col("Parameter")
    value: Measured = col("Value")


def parameters(made: CalibratedCamera) -> list[Parameter]:
    """Of the calibration of measured centroids with free attitudes, with the standard deviations it states."""
    solution, used = made.of("measured").calibration.solution, int(made.used.sum())
    units = f"{{{made.scene.name}_parameter}}"  # One by one, of `parameter_axis`
    return [
        Parameter(name=name, value=Measured(value=float(value), unit=units, uncertainty=float(sigma), n=used))
        for name, value, sigma in zip(solution.names, solution.value, solution.sigma, strict=True)
    ]


def parameter_axis(name: str) -> Callable[[Quantities, Sequence[Parameter]], None]:
    """Describes the dimension of a camera's parameters, whose names end in their units."""

    def unit(name: str) -> str:
        return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]

    def describe(q: Quantities, rows: Sequence[Parameter]) -> None:
        names = [one.name for one in rows]
        q.axis(f"{name}_parameter", names, "Parameter", units=[unit(one) for one in names])

    return describe


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Line-of-sight error at a place of the detector, model minus traced lens; its prediction and its parts."""

    place_px: FloatArray = col("Place", "px", dims="axis")
    error_arcsec: FloatArray = col("As measured", "arcsec", dims="axis")
    sigma_arcsec: FloatArray = col("Predicted σ", "arcsec", dims="axis")
    corrected_error_arcsec: FloatArray = col("Colours known", "arcsec", dims="axis")
    corrected_sigma_arcsec: FloatArray = col("Predicted σ, colours known", "arcsec", dims="axis")
    mismatch_arcsec: FloatArray = col("Camera model", "arcsec", dims="axis")
    chromatic_arcsec: FloatArray = col("Star colours", "arcsec", dims="axis")
    noise_arcsec: FloatArray = col("Noise and pixels", "arcsec", dims="axis")
    psf_arcsec: FloatArray = col("PSF of one colour", "arcsec", dims="axis")


def places(made: CalibratedCamera) -> list[Place]:
    """The map of the line of sight, row by row."""
    whole, fine = made.of("measured"), made.of("corrected")
    columns = {
        "place_px": made.chart.pixel_px,
        "error_arcsec": whole.error_arcsec,
        "sigma_arcsec": whole.map.predicted_sigma_arcsec,
        "corrected_error_arcsec": fine.error_arcsec,
        "corrected_sigma_arcsec": fine.map.predicted_sigma_arcsec,
        **{f"{part}_arcsec": error for part, error in made.part_arcsec.items()},
    }
    return [Place(**{name: values[k] for name, values in columns.items()}) for k in range(len(made.chart.pixel_px))]


@dataclass(frozen=True, slots=True, kw_only=True)
class Star:
    """A star that was calibrated with."""

    frame: int = col("Frame")
    id: int = col("Star")
    magnitude: float = col("G", "mag")
    temperature: float = col("Colour temperature", "K")
    snr: float = col("Signal-to-noise ratio")
    measured_px: FloatArray = col("PSF of one colour", "px", dims="axis")
    own_px: FloatArray = col("PSF of the star's colour", "px", dims="axis")
    light_px: FloatArray = col("Mean of all light", "px", dims="axis")
    reference_px: FloatArray = col("Light of the reference colour", "px", dims="axis")
    residual_px: FloatArray = col("Measured minus calibrated camera", "px", dims="axis")
    sigma_px: FloatArray = col("Stated σ", "px", dims="axis")


def stars(made: CalibratedCamera) -> list[Star]:
    """Every star that was calibrated with."""
    matched, used, sky = made.matched, made.used, made.scene.sky
    star = matched.star[used]
    columns: dict[str, Any] = {
        "frame": matched.frame[used],
        "id": sky.id[star],
        "magnitude": sky.magnitude[star],
        "temperature": sky.temperature_k[star],
        "snr": matched.snr[used],
        **{f"{kind}_px": made.position_px[kind][used] for kind in ("measured", "own", "light", "reference")},
        "residual_px": made.residual_px,
        "sigma_px": np.sqrt(np.diagonal(matched.covariance_px2[used], axis1=1, axis2=2)),
    }
    return [Star(**{name: values[k] for name, values in columns.items()}) for k in range(len(star))]


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Render, read out, measure, match, calibrate and compare."""
    root = Streams(config.seed).child("skycal")
    scenes = {name: build_scene(name, config, root.child(name)) for name in config.cameras}
    made = {name: calibrated(scene, config, root.child(name), progress) for name, scene in scenes.items()}
    result: dict[str, Any] = {
        "cameras": [camera(one) for one in made.values()],
        "methods": [map_error(list(made.values()), method) for method in METHODS],
    }
    for name, one in made.items():
        result |= {
            f"{name}_models": models(one),
            f"{name}_parameters": parameters(one),
            f"{name}_map": places(one),
            f"{name}_stars": stars(one),
        }
    return result


def calibrated(scene: Scene, config: Config, streams: Streams, progress: Progress) -> CalibratedCamera:
    """All of one camera."""
    with progress.stage(f"{scene.name}: frames", total=scene.frames) as stage:
        recording = record(scene, config, streams, advance=stage.advance)
    with progress.stage(f"{scene.name}: matches"):
        matched = match_frames(scene, recording, config)
    with progress.stage(f"{scene.name}: calibrations", total=len(scene.config.models) + 2) as stage:
        return calibrate_camera(scene, recording, matched, config, advance=stage.advance)


def files(result: Mapping[str, Any], folder: Path) -> None:
    """One frame of each camera as FITS."""
    for one in result["cameras"]:
        write_frame(one.made.recording.example, folder / f"frame_{one.made.scene.name}.fits")


def axes(config: Config) -> Quantities:
    """Dimensions that several sections share."""
    q = Quantities()
    q.axis("axis", ["x", "y"], "Axis")
    q.axis("method", METHODS, "Attitudes", names=METHOD_NAMES)
    q.axis("data", list(DATA), "Centroids", names=DATA)
    q.axis("part", PARTS, "Part", names=PART_NAMES)
    q.axis("pair", PAIRS, "Parts")
    q.axis("outcome", OUTCOMES, "Detections")
    for name, one in config.cameras.items():
        q.axis(f"{name}_model", one.models, "Model", names=[model_label(model) for model in one.models])
    return q


def camera_axis(q: Quantities, rows: Sequence[Camera]) -> None:
    """Cameras are called by their focal length."""
    focal = [one.made.scene.instrument.focal_length_mm for one in rows]
    names = [f"{f:.0f} mm" if f >= 100 else f"{f:.1f} mm" for f in focal]
    q.axis("camera", [one.made.scene.name for one in rows], "Lens", names=names)


def sections_of(name: str) -> dict[str, Section]:
    """Sections of one camera."""
    model = f"{name}_model"
    return {
        f"{name}_models": Section(
            record=Model,
            dim=model,
            table=f"models_{name}",
            caption="RMS map error by camera model.",
            note="Noiseless stars: the measured stars and weights, at the positions of light of the reference colour. "
            "Noise: predicted, with known star colours.",
            figures={
                f"{name}_model_curves": curves(
                    model,
                    points="measured_arcsec corrected_arcsec",
                    lines="mismatch_arcsec predicted_arcsec",
                    log="y",
                    y="Map error, RMS",
                    aspect_ratio=0.36,
                )
            },
        ),
        f"{name}_parameters": Section(
            record=Parameter,
            dim=f"{name}_parameter",
            along="name",
            axes=parameter_axis(name),
            table=f"parameters_{name}",
            caption="Parameters of the calibration, with the standard deviations it states.",
        ),
        f"{name}_map": Section(
            record=Place,
            dim=f"{name}_place",
            table=f"map_{name}",
            across="axis",
            hidden=f"{name}_place",
            caption="Line-of-sight error over the detector: model minus traced lens.",
            figures={f"{name}_map": arrows("place_px", "error_arcsec", "corrected_error_arcsec")},
        ),
        f"{name}_stars": Section(
            record=Star,
            dim=f"{name}_star",
            table=f"stars_{name}",
            across="axis",
            hidden=f"{name}_star",
            caption="Stars used in the calibration.",
        ),
    }


SECTIONS: dict[str, Section] = {
    "cameras": Section(
        record=Camera,
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
            below("wrong_part", WRONG_LIMIT, title="fraction of wrong matches, largest of the cameras"),
            below(
                "not_converged",
                0.0,
                title="calibrations from poor start values that did not converge, of 4 per camera",
                advice="set start.focal_ratio nearer to 1",
            ),
            ratio_near(
                "centroid_pull",
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
