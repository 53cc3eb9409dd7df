"""Criteria of the calibration under the sky, and what goes into ``summary.json``."""

from __future__ import annotations

from itertools import combinations
from typing import Any

from experiments.harness.summary import Criterion, Measured
from experiments.skycal.calibrate import METHODS, Judged, rms
from experiments.skycal.evaluate import PARTS
from experiments.skycal.result import CameraResult, Result

__all__ = ["criteria", "results"]

LEAST_CHANCE = 1e-3
"""A noise map may be as unlikely as this; with four of them one seed in 250 fails by chance."""
WRONG_LIMIT = 1e-3


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed."""
    return [one for camera in result.cameras.values() for one in _of(camera)]


def _of(camera: CameraResult) -> list[Criterion]:
    name, total, corrected = camera.title, camera.total, camera.of("corrected")
    linked = camera.of("corrected", method="linked")
    counting = (total, corrected, linked, camera.of("measured", method="linked"))
    robust, hopeless = camera.evaluation.wrong[1:]
    mismatch = camera.evaluation.part_rms_arcsec["mismatch"]
    return [
        Criterion(
            name=f"{name}: wrong matches among the stars calibrated with, part of them",
            value=float((~camera.matched.right).mean()),
            limit=WRONG_LIMIT,
        ),
        Criterion(
            name=f"{name}: calibrations from poor start values that did not converge, of {len(counting)}",
            value=float(sum(not one.calibration.converged for one in counting)),
            limit=0.0,
        ),
        Criterion(
            name=f"{name}: probability of such a noise map under its predicted covariance, free attitudes",
            value=camera.noise_map_chance,
            limit=LEAST_CHANCE,
            relation=">=",
        ),
        Criterion(
            name=f"{name}: probability of such a noise map under its predicted covariance, with the gyro",
            value=camera.linked_map_chance,
            limit=LEAST_CHANCE,
            relation=">=",
        ),
        Criterion(
            name=f"{name}: error of noiseless stars, against the model's own limit plus the predicted uncertainty",
            value=mismatch,
            limit=camera.evaluation.direct[camera.scene.config.model].rms_arcsec + total.predicted_arcsec,
            unit="arcsec",
        ),
        Criterion(
            name=f"{name}: how far {100 * robust.fraction:.0f} % wrong matches move the map, against its uncertainty",
            value=robust.apart_arcsec if robust.accepted else float("nan"),
            limit=total.predicted_arcsec,
            unit="arcsec",
        ),
        Criterion(
            name=f"{name}: calibrations accepted with {100 * hopeless.fraction:.0f} % wrong matches",
            value=float(hopeless.accepted),
            limit=0.0,
        ),
    ]


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    return {
        "rendered": {name: _summary(camera) for name, camera in result.cameras.items()},
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }


def _unit(name: str) -> str:
    """Unit that the name of a parameter ends in."""
    return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]


def _map(judged: Judged) -> dict[str, Any]:
    return {
        "rms": judged.rms_arcsec,
        "max": judged.max_arcsec,
        "predicted": judged.predicted_arcsec,
        "predicted_spread": judged.predicted_spread_arcsec,
        "status": judged.calibration.solution.status,
        "iterations": judged.calibration.solution.iterations,
    }


def _summary(camera: CameraResult) -> dict[str, Any]:
    evaluation, scene = camera.evaluation, camera.scene
    solution = camera.total.calibration.solution
    used = int(evaluation.used.sum())
    sigma = dict(zip(solution.names, solution.sigma, strict=True))
    return {
        "lens": scene.instrument.camera.lens.name,
        "detector": scene.instrument.detector.name,
        "field_deg": scene.instrument.field_deg,
        "pixel_arcsec": scene.pixel_arcsec,
        "sky": scene.sky.name,
        "frames": scene.frames,
        "frames_matched": camera.matched.first_matched,
        "detections": camera.matched.count,
        "stars": used,
        "stars_per_frame": camera.stars_per_frame,
        "wrong_matches": int((~camera.matched.right).sum()),
        "camera_model": scene.config.model,
        "map_error_arcsec": _map(camera.total),
        "map_error_corrected_arcsec": _map(camera.of("corrected")),
        "noise_map_arcsec": {
            "rms": camera.noise_map_rms_arcsec,
            "predicted": camera.of("corrected").predicted_arcsec,
            "probability": camera.noise_map_chance,
        },
        "parts_arcsec": {part: rms(evaluation.part_arcsec[part]) for part in PARTS},
        "quadrature_arcsec": evaluation.quadrature_arcsec,
        "parts_correlation": {f"{one}, {other}": evaluation.alike(one, other) for one, other in combinations(PARTS, 2)},
        "models_arcsec": {
            model: {
                **{data: camera.of(data, model=model).rms_arcsec for data in ("reference", "measured", "corrected")},
                "predicted": camera.of("measured", model=model).predicted_arcsec,
                "direct": evaluation.direct[model].rms_arcsec,
                "status": camera.of("measured", model=model).calibration.solution.status,
            }
            for model in scene.config.models
        },
        "methods_arcsec": {
            method: {data: _map(camera.of(data, method=method)) for data in ("measured", "corrected")}
            for method in METHODS
        },
        "wrong_matches_put_in": [
            {
                "loss": one.loss,
                "fraction": one.fraction,
                "status": one.status,
                "map_error_arcsec": one.rms_arcsec,
                "apart_arcsec": one.apart_arcsec,
                "caught_fraction": one.caught_fraction,
            }
            for one in evaluation.wrong
        ],
        "centroid_floor_px": {"measured": evaluation.floor_px, "corrected": evaluation.corrected_floor_px},
        "parameters": {
            name: Measured(value=float(value), unit=_unit(name), uncertainty=float(sigma[name]), n=used)
            for name, value in zip(solution.names, solution.value, strict=True)
        },
        "reduced_chi2": solution.reduced_chi2,
    }
