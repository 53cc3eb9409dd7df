"""Tables of the calibration under the sky, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table
from experiments.skycal.calibrate import METHODS, Judged
from experiments.skycal.evaluate import PARTS
from experiments.skycal.result import CameraResult, Result
from experiments.skycal.settings import model_label

__all__ = ["all_tables"]

LEFT_OUT = ("not converged", "saturated", "blended", "at the edge", "defective pixel", "too faint", "not matched")
SHORT = {"mismatch": "Camera model", "chromatic": "Star colours", "noise": "Noise", "psf": "PSF"}


def all_tables(result: Result) -> Mapping[str, Table]:
    """Every table by its file name."""
    cameras = list(result.cameras.values())
    return {
        "cameras": _cameras(cameras),
        "parts": _parts(cameras),
        "models": _models(cameras),
        "methods": _methods(cameras),
        "wrong": _wrong(cameras),
        "detections": _detections(cameras),
        "parameters": _parameters(cameras),
        **{f"map_{camera.name}": _map(camera) for camera in cameras},
        **{f"stars_{camera.name}": _stars(camera) for camera in cameras},
    }


def _arcsec(name: str, key: str) -> Column:
    return Column(name=name, unit="arcsec", key=key, format=".4f")


def _predicted(judged: Judged) -> Measured:
    return Measured(value=judged.predicted_arcsec, unit="arcsec", uncertainty=judged.predicted_spread_arcsec)


def _cameras(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        total, fine = camera.total, camera.of("corrected")
        rows.append(
            (
                camera.short,
                total.rms_arcsec,
                total.max_arcsec,
                _predicted(total),
                fine.rms_arcsec,
                camera.noise_map_rms_arcsec,
                _predicted(fine),
            )
        )
    return Table(
        columns=(
            "Lens",
            _arcsec("Measured", "measured_arcsec"),
            _arcsec("largest", "largest_arcsec"),
            Column(name="predicted", unit="arcsec", key="measured_predicted_arcsec"),
            _arcsec("Colours known", "corrected_arcsec"),
            _arcsec("noise only", "noise_arcsec"),
            Column(name="predicted", unit="arcsec", key="corrected_predicted_arcsec"),
        ),
        rows=rows,
        caption="Line of sight of the calibrated cameras against the traced lens, best rotation removed.",
        note="RMS length over the detector. Colours known: centroids with the PSF of each star's colour, colour shift "
        "taken off; noise only: without what the camera model cannot describe. Predicted: from the covariance of the "
        "calibration; ± is how much such a map scatters.",
    )


def _parts(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        sizes = camera.evaluation.part_rms_arcsec
        rows.append(
            (
                camera.short,
                *(sizes[part] for part in PARTS),
                camera.evaluation.quadrature_arcsec,
                camera.total.rms_arcsec,
                camera.evaluation.alike("chromatic", "psf"),
            )
        )
    return Table(
        columns=(
            "Lens",
            *(Column(name=SHORT[part], unit="arcsec", key=f"{part}_arcsec", format=".2g") for part in PARTS),
            _arcsec("RSS", "quadrature_arcsec"),
            _arcsec("Total", "total_arcsec"),
            Column(name="ρ", key="chromatic_psf_correlation", format="+.2f"),
        ),
        rows=rows,
        caption="What the map error is made of: RMS of each part, switched on one after the other in the same data.",
        note="RSS: root sum square. ρ: correlation of star colours and PSF over the detector. Independent "
        "parts would add in quadrature; parts that cancel make the total smaller.",
    )


def _models(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        for model in camera.scene.config.models:
            measured, clean = camera.of("measured", model=model), camera.of("reference", model=model)
            rows.append(
                (
                    camera.short,
                    model_label(model),
                    len(measured.calibration.solution.names),
                    camera.evaluation.direct[model].rms_arcsec,
                    clean.rms_arcsec,
                    camera.of("corrected", model=model).predicted_arcsec,
                    measured.rms_arcsec,
                    camera.of("corrected", model=model).rms_arcsec,
                    measured.calibration.solution.status,
                )
            )
    return Table(
        columns=(
            "Lens",
            "Model",
            Column(name="Free", key="parameters"),
            Column(name="Own limit", unit="arcsec", key="direct_arcsec", format=".2g"),
            Column(name="Noiseless", unit="arcsec", key="mismatch_arcsec", format=".2g"),
            Column(name="Noise", unit="arcsec", key="predicted_arcsec", format=".4f"),
            Column(name="Measured", unit="arcsec", key="measured_arcsec", format=".4f"),
            Column(name="Colours known", unit="arcsec", key="corrected_arcsec", format=".4f"),
            "Status",
        ),
        rows=rows,
        caption="Which camera model is enough: what it cannot describe, what noise does to it, what comes out.",
        note="Map errors, RMS. Free: parameters. Own limit: the model fitted to the traced map itself. Noiseless: "
        "the same "
        "stars and weights as measured, at the places that light of the reference colour would have. Noise: predicted, "
        "with star colours known.",
    )


def _methods(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        for method, label in METHODS.items():
            measured, fine = (camera.of(data, method=method) for data in ("measured", "corrected"))
            sigma = _sigma(fine)
            rows.append(
                (
                    camera.short,
                    label,
                    measured.rms_arcsec,
                    fine.rms_arcsec,
                    _predicted(fine),
                    sigma.get("x0_px", np.nan),
                    sigma.get("focal_length_mm", np.nan) * 1e3,
                    fine.calibration.solution.reduced_chi2,
                )
            )
    return Table(
        columns=(
            "Lens",
            "Attitudes",
            _arcsec("Measured", "measured_arcsec"),
            _arcsec("Colours known", "corrected_arcsec"),
            Column(name="Predicted", unit="arcsec", key="predicted_arcsec"),
            Column(name="σ of x0", unit="px", key="sigma_x0_px", format=".3f"),
            Column(name="σ of f", unit="µm", key="sigma_f_um", format=".3f"),
            Column(name="χ² per degree", key="reduced_chi2", format=".2f"),
        ),
        rows=rows,
        caption="Attitudes free in every frame, or linked by a gyro: map errors (RMS) from the same centroids.",
        note="Predicted map error and standard deviations of principal point and focal length for known colours. A χ² "
        "well above 1 says that the gyro is not as good as the method believes.",
    )


def _sigma(judged: Judged) -> dict[str, float]:
    solution = judged.calibration.solution
    return {name: float(value) for name, value in zip(solution.names, solution.sigma, strict=True)}


def _wrong(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        rows.append((camera.short, "robust (tukey)", 0.0, _status(camera.total), camera.total.rms_arcsec, 0.0, None))
        for one in camera.evaluation.wrong:
            loss = "least squares" if one.loss == "linear" else f"robust ({one.loss})"
            status = "accepted" if one.accepted else "refused"
            caught = 100 * one.caught_fraction if one.loss != "linear" else None
            rows.append((camera.short, loss, 100 * one.fraction, status, one.rms_arcsec, one.apart_arcsec, caught))
    return Table(
        columns=(
            "Lens",
            "Loss",
            Column(name="Wrong matches", unit="%", key="wrong_percent", format=".0f"),
            "Outcome",
            Column(name="Map error, RMS", unit="arcsec", key="map_rms_arcsec", format=".4g"),
            Column(name="From the clean map", unit="arcsec", key="apart_arcsec", format=".4g"),
            Column(name="Caught", unit="%", key="caught_percent", format=".1f"),
        ),
        rows=rows,
        caption="Wrong matches put in on purpose: stars of one frame exchange their names.",
        note="Refused: the calibration itself says that it must not be used; its map is shown all the same. Caught: "
        "wrong matches that were left without weight.",
    )


def _status(judged: Judged) -> str:
    return "accepted" if judged.calibration.converged else "refused"


def _detections(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        ("rendered", *(sum(len(one.star) for one in camera.recording.frames) for camera in cameras)),
        ("detected", *(sum(camera.matched.count.values()) for camera in cameras)),
    ]
    for name in LEFT_OUT:
        rows.append((f"– {name}", *(camera.matched.count[name] for camera in cameras)))
    rows.append(("used", *(int(camera.evaluation.used.sum()) for camera in cameras)))
    wrong = [int((~camera.matched.right[camera.evaluation.used]).sum()) for camera in cameras]
    rows.append(("of them wrong", *wrong))
    return Table(
        columns=("Stars", *(Column(name=camera.title, key=f"{camera.name}_stars") for camera in cameras)),
        rows=rows,
        caption="What became of the stars, all frames together.",
        note="A detection is counted under the first reason that holds. Wrong: used stars under another star's name, "
        "by the truth of the rendering.",
    )


def _parameters(cameras: list[CameraResult]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for camera in cameras:
        solution = camera.total.calibration.solution
        for name, value, sigma in zip(solution.names, solution.value, solution.sigma, strict=True):
            rows.append((camera.short, name, Measured(value=float(value), uncertainty=float(sigma))))
    return Table(
        columns=("Lens", "Parameter", Column(name="Value", key="value")),
        rows=rows,
        caption="Parameters of the calibration that counts, with the standard deviations it states.",
        note="Ideal to distorted, in mm from the principal point; x0, y0 from the centre of the detector.",
    )


def _map(camera: CameraResult) -> Table:
    """The maps themselves."""
    evaluation, total, fine = camera.evaluation, camera.total, camera.of("corrected")
    rows = [
        tuple(float(v) for v in row)
        for row in np.column_stack(
            [
                evaluation.chart.pixel_px,
                total.error_arcsec,
                total.sigma_arcsec,
                fine.error_arcsec,
                fine.sigma_arcsec,
                *(evaluation.part_arcsec[part] for part in PARTS),
            ]
        )
    ]
    names = ("error", "sigma", "corrected_error", "corrected_sigma", *PARTS)
    return Table(
        columns=(
            Column(name="x", unit="px", key="x_px"),
            Column(name="y", unit="px", key="y_px"),
            *(Column(name=f"{n} {axis}", unit="arcsec", key=f"{n}_{axis}_arcsec") for n in names for axis in "xy"),
        ),
        rows=rows,
        caption=f"Line-of-sight error over the detector, {camera.title}: model minus traced lens.",
    )


def _stars(camera: CameraResult) -> Table:
    """Every star that was calibrated with."""
    used, matched = camera.evaluation.used, camera.matched
    position = camera.evaluation.position_px
    sky = camera.scene.sky
    kinds = ("measured", "own", "light", "reference")
    columns = np.column_stack([position[kind][used] for kind in kinds] + [camera.evaluation.residual_px])
    star = matched.star[used]
    known = (matched.frame[used], sky.id[star], sky.magnitude[star], sky.temperature_k[star], matched.snr[used])
    rows = [
        (int(frame), int(name), *(float(v) for v in known), *(float(v) for v in place))
        for frame, name, *known, place in zip(*known, columns, strict=True)
    ]
    return Table(
        columns=(
            Column(name="frame", key="frame"),
            Column(name="star", key="star"),
            Column(name="G", unit="mag", key="g_mag"),
            Column(name="colour temperature", unit="K", key="temperature_k"),
            Column(name="SNR", key="snr"),
            *(
                Column(name=f"{kind} {axis}", unit="px", key=f"{kind}_{axis}_px")
                for kind in (*kinds, "residual")
                for axis in "xy"
            ),
        ),
        rows=rows,
        caption=f"Stars calibrated with, {camera.title}.",
        note="measured: PSF of one colour; own: PSF of the star's colour; light: centroid of the noiseless light; "
        "reference: where light of the reference colour would fall; residual: measured minus calibrated camera.",
    )
