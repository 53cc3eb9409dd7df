"""The numbers of the calibration under the sky, each described once.

What every camera has runs along the dimension ``camera``; what differs in number from camera to camera (models,
parameters, places of the map, stars) has a name that begins with the camera's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.harness.quantities import Places, Quantities
from experiments.harness.summary import Measured
from experiments.skycal.calibrate import METHODS, CalibratedMap
from experiments.skycal.evaluate import PARTS
from experiments.skycal.result import CameraResult, Result
from experiments.skycal.settings import model_label

__all__ = ["describe"]

XY = ["x", "y"]
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
POSITIONS = ("measured", "own", "light", "reference")


def describe(result: Result) -> Quantities:
    """Quantities of a run: cameras, stars, map errors, what they are made of, and the maps and stars themselves."""
    q, cameras = Quantities(), list(result.cameras.values())
    q.axis("camera", list(result.cameras), "Lens", names=[camera.short for camera in cameras])
    q.axis("axis", XY, "Axis")
    q.axis("method", METHODS, "Attitudes", names=METHOD_NAMES)
    q.axis("data", list(DATA), "Centroids", names=DATA)
    q.axis("part", PARTS, "Part", names=PART_NAMES)
    of_each = _OfEach(q, cameras)
    _set_up(of_each)
    _stars(of_each)
    _noise_map_and_parts(of_each)
    _wrong_matches(of_each)
    _independent(of_each)
    for data in DATA:
        _map_errors(q, cameras, data)
    for camera in cameras:
        _models(q, camera)
        _parameters(q, camera)
        _map(q, camera)
        _star_list(q, camera)
    return q


@dataclass(frozen=True, slots=True)
class _OfEach:
    """Describes what every camera has."""

    q: Quantities
    cameras: Sequence[CameraResult]

    def add(
        self, name: str, label: str, part: Callable[[CameraResult], Any], dims: str = "camera", **described: Any
    ) -> None:
        """A quantity; ``json`` is its place in the record of the camera, its name if left out."""
        json = described.pop("json", name)
        place = json and f"rendered[camera].{json}"
        self.q.add(name, [part(camera) for camera in self.cameras], label, dims=dims, json=place, **described)


def _set_up(of_each: _OfEach) -> None:
    """What was calibrated, under which sky."""
    of_each.add("lens", "Lens", lambda c: c.scene.instrument.camera.lens.name)
    of_each.add("detector", "Detector", lambda c: c.scene.instrument.detector.name)
    of_each.add("field_deg", "Field", lambda c: c.scene.instrument.field_deg, "camera side", unit="deg", format=".1f")
    of_each.add("pixel_arcsec", "Angle of a pixel", lambda c: c.scene.pixel_arcsec, unit="arcsec")
    of_each.add("sky", "Sky", lambda c: c.scene.sky.name)
    of_each.add("frames", "Frames", lambda c: c.scene.frames)
    of_each.add("camera_model", "Camera model", lambda c: c.scene.config.model)


def _stars(of_each: _OfEach) -> None:
    """What became of the stars and of the detections, all frames together."""
    of_each.q.axis("outcome", list(of_each.cameras[0].matched.count), "Detections")
    of_each.add("detections", "Detections", lambda c: list(c.matched.count.values()), "camera outcome")
    of_each.add("rendered", "rendered", lambda c: sum(len(one.star) for one in c.recording.frames), json="")
    of_each.add("frames_matched", "Frames matched", lambda c: c.matched.first_matched)
    of_each.add("stars", "used", lambda c: int(c.evaluation.used.sum()))
    of_each.add("stars_per_frame", "Stars used per frame", lambda c: c.stars_per_frame)
    of_each.add("wrong_matches", "Wrong matches", lambda c: int((~c.matched.correct).sum()))
    of_each.add("wrong_used", "of them wrong", lambda c: int((~c.matched.correct[c.evaluation.used]).sum()), json="")
    floor_px = _values("floor_px")
    of_each.add("centroid_floor_px", "Error beyond noise", floor_px, "camera data", unit="px", format=".3f")


def _independent(of_each: _OfEach) -> None:
    """The calibration that counts by equations written out (`experiments.skycal.independent`)."""
    for name, label, unit in (
        ("attitude_off_sigma", "Attitudes off the commanded motion, farthest", "sigma"),
        ("residual_off_px", "Residuals off those written out, largest", "px"),
        ("moved_part", "Known moves of stars and sky, part that did not come back", ""),
        ("focal_ratio", "Focal length over the paraxial one", ""),
    ):
        of_each.add(name, label, _checked(name), unit=unit, json=f"independent.{name}")


def _checked(name: str) -> Callable[[CameraResult], float]:
    return lambda camera: float(getattr(camera.evaluation.check, name))


def _values(name: str) -> Callable[[CameraResult], list[Any]]:
    return lambda camera: list(getattr(camera.evaluation, name).values())


def _noise_map_and_parts(of_each: _OfEach) -> None:
    """What noise alone does to the map, and what the map error is made of."""
    arcsec = {"unit": "arcsec", "format": ".4f"}
    noise = {"key": "noise_arcsec", "json": "noise_map_arcsec.rms"} | arcsec
    of_each.add("noise_map_rms_arcsec", "noise only", lambda c: c.noise_map_rms_arcsec, **noise)
    label, json = "Probability of such a noise map", "noise_map_arcsec.probability"
    of_each.add("noise_map_probability", label, lambda c: c.noise_map_probability, json=json)
    of_each.add("linked_map_probability", label, lambda c: c.linked_map_probability, json="")
    part = {"unit": "arcsec", "format": ".2g", "key": "{part}_arcsec", "json": "parts_arcsec"}
    of_each.add("part_rms_arcsec", "RMS", _values("part_rms_arcsec"), "camera part", **part)
    of_each.add("quadrature_arcsec", "RSS", lambda c: c.evaluation.quadrature_arcsec, **arcsec)
    of_each.q.axis("pair", list(of_each.cameras[0].evaluation.part_correlation), "Parts")
    pair = {"format": "+.2f", "json": "parts_correlation"}
    of_each.add("part_correlation", "ρ", _values("part_correlation"), "camera pair", **pair)


def _wrong_matches(of_each: _OfEach) -> None:
    """Calibrations with wrong matches put in on purpose."""
    for name, label, place in (
        ("loss", "Loss", "loss"),
        ("fraction", "Wrong matches", "fraction"),
        ("status", "Status", "status"),
        ("rms_arcsec", "Map error, RMS", "map_error_arcsec"),
        ("apart_arcsec", "From the clean map", "apart_arcsec"),
        ("caught_fraction", "Caught", "caught_fraction"),
    ):
        unit, json = "arcsec" if name.endswith("_arcsec") else "", f"wrong_matches_put_in[trial].{place}"
        of_each.add(f"wrong_{name}", label, _of_trials(name), "camera trial", unit=unit, json=json)


def _of_trials(name: str) -> Callable[[CameraResult], list[Any]]:
    return lambda camera: [getattr(one, name) for one in camera.evaluation.wrong_matches]


def _map_errors(q: Quantities, cameras: Sequence[CameraResult], data: str) -> None:
    """Line of sight of the calibrated cameras against the traced lens, by how attitudes are treated."""
    whole = {"measured": "map_error_arcsec", "corrected": "map_error_corrected_arcsec"}[data]
    also = {"predicted": ["rendered[camera].noise_map_arcsec.predicted"]} if data == "corrected" else {}
    label = {"measured": "Measured", "corrected": "Colours known"}[data]

    def each(part: Callable[[CalibratedMap], Any]) -> list[list[Any]]:
        return [[part(camera.of(data, method=method)) for camera in cameras] for method in METHODS]

    def places(name: str) -> Places:
        inner = f"rendered[camera].methods_arcsec[method].{data}.{name}"
        return {"*": inner, "free": [f"rendered[camera].{whole}.{name}", *also.get(name, [])]}

    angle = {"unit": "arcsec", "dims": "method camera"}
    for name, head, key, size in (
        ("rms", label, f"{data}_arcsec", lambda m: m.rms_arcsec),
        ("max", "largest", "largest_arcsec", lambda m: m.max_arcsec),
    ):
        q.add(f"{data}_{name}_arcsec", each(size), head, **angle, format=".4f", key=key, json=places(name))
    q.add(
        f"{data}_predicted_arcsec",
        each(lambda m: m.predicted_arcsec),
        "predicted",
        **angle,
        error=each(lambda m: m.predicted_spread_arcsec),
        json=places("predicted"),
        json_error=places("predicted_spread"),
    )
    for name, of_fit in (
        ("status", lambda m: m.calibration.solution.status),
        ("iterations", lambda m: m.calibration.solution.iterations),
    ):
        q.add(f"{data}_{name}", each(of_fit), name.capitalize(), dims="method camera", json=places(name))
    for name, label, unit, format, part in (
        ("sigma_x0_px", "σ of x0", "px", ".3f", lambda m: _sigma(m, "x0_px")),
        ("sigma_f_um", "σ of f", "um", ".3f", lambda m: 1e3 * _sigma(m, "focal_length_mm")),
        ("reduced_chi2", "χ² per degree", "", ".2f", lambda m: m.calibration.solution.reduced_chi2),
    ):
        json = {"free": f"rendered[camera].{name}"} if (data, name) == ("measured", "reduced_chi2") else ""
        q.add(f"{data}_{name}", each(part), label, unit=unit, dims="method camera", format=format, key=name, json=json)


def _sigma(fitted: CalibratedMap, parameter: str) -> float:
    solution = fitted.calibration.solution
    return float(dict(zip(solution.names, solution.sigma, strict=True)).get(parameter, np.nan))


def _models(q: Quantities, camera: CameraResult) -> None:
    """Camera models fitted to the same stars: what they cannot describe, what noise does to them, what comes out."""
    models, dim = camera.scene.config.models, f"{camera.name}_model"
    q.axis(dim, models, "Model", key="model", names=[model_label(model) for model in models])
    free = [len(camera.of("measured", model=model).calibration.solution.names) for model in models]
    q.add(f"{dim}_parameters", free, "Free", dims=dim, key="parameters", json="")
    direct = camera.evaluation.direct

    def of(data: str, model: str) -> CalibratedMap:
        return camera.of(data, model=model)

    for name, label, json, format, part in (
        ("direct_arcsec", "Own limit", "direct", ".2g", lambda m: direct[m].rms_arcsec),
        ("mismatch_arcsec", "Noiseless", "reference", ".2g", lambda m: of("reference", m).rms_arcsec),
        ("predicted_arcsec", "Noise", "", ".4f", lambda m: of("corrected", m).predicted_arcsec),
        ("measured_arcsec", "Measured", "measured", ".4f", lambda m: of("measured", m).rms_arcsec),
        ("corrected_arcsec", "Colours known", "corrected", ".4f", lambda m: of("corrected", m).rms_arcsec),
        ("measured_predicted_arcsec", "Predicted", "predicted", ".4f", lambda m: of("measured", m).predicted_arcsec),
    ):
        place = json and f"rendered.{camera.name}.models_arcsec[{dim}].{json}"
        values = [part(model) for model in models]
        q.add(f"{dim}_{name}", values, label, unit="arcsec", dims=dim, format=format, key=name, json=place)
    status = [camera.of("measured", model=model).calibration.solution.status for model in models]
    place = f"rendered.{camera.name}.models_arcsec[{dim}].status"
    q.add(f"{dim}_status", status, "Status", dims=dim, key="status", json=place)


def _parameters(q: Quantities, camera: CameraResult) -> None:
    """Of the calibration that counts; ideal to distorted, in mm from the principal point."""
    solution, used = camera.total.calibration.solution, int(camera.evaluation.used.sum())
    for name, value, sigma in zip(solution.names, solution.value, solution.sigma, strict=True):
        one = Measured(value=float(value), unit=_unit(name), uncertainty=float(sigma), n=used)
        q.add(f"{camera.name}_{name}", one, name, json=f"rendered.{camera.name}.parameters.{name}")


def _unit(name: str) -> str:
    """Unit that the name of a parameter ends in."""
    return f"1/{name.rpartition('_per_')[2]}" if "_per_" in name else name.rpartition("_")[2]


def _map(q: Quantities, camera: CameraResult) -> None:
    """Line-of-sight error over the detector, its prediction and its parts; model minus traced lens."""
    evaluation, fine, chart = camera.evaluation, camera.of("corrected"), camera.evaluation.chart
    dims = f"{camera.name}_row {camera.name}_column axis"
    shape = (chart.rows, chart.columns, 2)
    place = {"unit": "px", "dims": dims, "key": "{axis}_px", "json": ""}
    q.add(f"{camera.name}_map_px", np.reshape(chart.pixel_px, shape), "Place", **place)
    for name, label, values in (
        ("error", "Error", camera.total.error_arcsec),
        ("sigma", "Predicted σ", camera.total.sigma_arcsec),
        ("corrected_error", "Error, colours known", fine.error_arcsec),
        ("corrected_sigma", "Predicted σ, colours known", fine.sigma_arcsec),
        *((part, PART_NAMES[part].capitalize(), evaluation.part_arcsec[part]) for part in PARTS),
    ):
        key = f"{name}_{{axis}}_arcsec"
        whole = np.reshape(values, shape)
        q.add(f"{camera.name}_{name}_arcsec", whole, label, unit="arcsec", dims=dims, key=key, json="")


def _star_list(q: Quantities, camera: CameraResult) -> None:
    """Every star that was calibrated with."""
    matched, used, sky = camera.matched, camera.evaluation.used, camera.scene.sky
    star, dim = matched.star[used], f"{camera.name}_star"
    for name, label, unit, key, values in (
        ("frame", "Frame", "", "frame", matched.frame[used]),
        ("id", "Star", "", "star", sky.id[star]),
        ("magnitude", "G", "mag", "g_mag", sky.magnitude[star]),
        ("temperature", "Colour temperature", "K", "temperature_k", sky.temperature_k[star]),
        ("snr", "Signal-to-noise ratio", "", "snr", matched.snr[used]),
    ):
        q.add(f"{dim}_{name}", values, label, unit=unit, dims=dim, key=key, json="")
    position = {kind: camera.evaluation.position_px[kind][used] for kind in POSITIONS}
    for kind, values in (position | {"residual": camera.evaluation.residual_px}).items():
        key = f"{kind}_{{axis}}_px"
        q.add(f"{dim}_{kind}_px", values, kind.capitalize(), unit="px", dims=f"{dim} axis", key=key, json="")
