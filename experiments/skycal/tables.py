"""Tables of the calibration under the sky, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from experiments.harness.pivot import Pivot, pivot
from experiments.harness.quantities import Outcome
from experiments.harness.summary import Measured
from experiments.harness.tables import Cell, Column, Table

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Table | Pivot]:
    """Tables by file name."""
    cameras = list(outcome.result.cameras)
    return {
        "cameras": Pivot(
            rows="camera",
            where={"method": "free"},
            columns="measured_rms_arcsec measured_max_arcsec measured_predicted_arcsec corrected_rms_arcsec "
            "noise_map_rms_arcsec corrected_predicted_arcsec",
            caption="Line of sight of the calibrated cameras against the traced lens, best rotation removed.",
            note="RMS length over the detector. Colours known: centroids with the PSF of each star's colour, colour "
            "shift taken off; noise only: without what the camera model cannot describe. Predicted: from the "
            "covariance of the calibration; ± is how much such a map scatters.",
        ),
        "parts": Pivot(
            rows="camera",
            across="part",
            where={"method": "free", "pair": "chromatic, psf"},
            columns="part_rms_arcsec quadrature_arcsec measured_rms_arcsec part_correlation",
            heads={
                "mismatch_arcsec": Column(name="Camera model"),
                "chromatic_arcsec": Column(name="Star colours"),
                "noise_arcsec": Column(name="Noise"),
                "psf_arcsec": Column(name="PSF"),
                "measured_arcsec": Column(name="Total", key="total_arcsec"),
                "part_correlation": Column(name="ρ", key="chromatic_psf_correlation"),
            },
            caption="What the map error is made of: RMS of each part, switched on one after the other in the same "
            "data.",
            note="RSS: root sum square. ρ: correlation of star colours and PSF over the detector. Independent parts "
            "would add in quadrature; parts that cancel make the total smaller.",
        ),
        "models": _models(outcome),
        "methods": Pivot(
            rows="camera method",
            columns="measured_rms_arcsec corrected_rms_arcsec corrected_predicted_arcsec corrected_sigma_x0_px "
            "corrected_sigma_f_um corrected_reduced_chi2",
            heads={"corrected_predicted_arcsec": Column(name="Predicted", key="predicted_arcsec")},
            caption="Attitudes free in every frame, or linked by a gyro: map errors (RMS) from the same centroids.",
            note="Predicted map error and standard deviations of principal point and focal length for known colours. A "
            "χ² well above 1 says that the gyro is not as good as the method believes.",
        ),
        "wrong": _wrong_matches(outcome),
        "detections": _detections(outcome),
        "parameters": _parameters(outcome),
        **{f"map_{name}": _map(outcome, name) for name in cameras},
        **{f"stars_{name}": _stars(outcome, name) for name in cameras},
    }


def _models(outcome: Outcome) -> Table:
    """Each camera has models of its own."""
    columns = ("parameters", *(f"{name}_arcsec" for name in ("direct", "mismatch", "predicted", "measured")))
    columns = (*columns, "corrected_arcsec", "status")
    parts = {
        lens: pivot(
            outcome.data,
            Pivot(rows=f"{name}_model", columns=" ".join(f"{name}_model_{column}" for column in columns)),
        )
        for name, lens in outcome.labels("camera").items()
    }
    return Table(
        columns=("Lens", *next(iter(parts.values())).columns),
        rows=[(lens, *row) for lens, part in parts.items() for row in part.rows],
        caption="Which camera model is enough: what it cannot describe, what noise does to it, what comes out.",
        note="Map errors, RMS. Free: parameters. Own limit: the model fitted to the traced map itself. Noiseless: the "
        "same stars and weights as measured, at the places that light of the reference colour would have. Noise: "
        "predicted, with star colours known.",
    )


def _wrong_matches(outcome: Outcome) -> Table:
    """The calibration that counts, and those with wrong matches put in."""

    def verdict(status: str) -> str:
        return "accepted" if status == "converged" else "refused"

    rows: list[tuple[Cell, ...]] = []
    for name, lens in outcome.labels("camera").items():
        free = {"camera": name, "method": "free"}
        status, size = (outcome.value(f"measured_{one}", **free) for one in ("status", "rms_arcsec"))
        rows.append((lens, "robust (tukey)", 0.0, verdict(status), size, 0.0, None))
        for trial in range(outcome.data.sizes["trial"]):
            loss, fraction, status, size, apart, caught = (
                outcome.value(f"wrong_{one}", camera=name, trial=trial)
                for one in ("loss", "fraction", "status", "rms_arcsec", "apart_arcsec", "caught_fraction")
            )
            plain = loss == "linear"
            label = "least squares" if plain else f"robust ({loss})"
            rows.append((lens, label, 100 * fraction, verdict(status), size, apart, None if plain else 100 * caught))
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


def _detections(outcome: Outcome) -> Table:
    """Stars that were rendered, detected, left out and used, a column for each camera."""
    count, reasons = outcome.values("detections"), outcome.names("outcome")[1:]
    rows = [
        ("rendered", outcome.values("rendered")),
        ("detected", count.sum(axis=1)),
        *((f"– {reason}", count[:, 1 + n]) for n, reason in enumerate(reasons)),
        ("used", outcome.values("stars")),
        ("of them wrong", outcome.values("wrong_used")),
    ]
    heads = [Column(name=f"{lens} lens", key=f"{name}_stars") for name, lens in outcome.labels("camera").items()]
    return Table(
        columns=("Stars", *heads),
        rows=[(label, *numbers.tolist()) for label, numbers in rows],
        caption="What became of the stars, all frames together.",
        note="A detection is counted under the first reason that holds. Wrong: used stars under another star's name, "
        "by the truth of the rendering.",
    )


def _parameters(outcome: Outcome) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, lens in outcome.labels("camera").items():
        for parameter in outcome.result.cameras[name].total.calibration.solution.names:
            value: Measured = outcome.value(f"{name}_{parameter}")
            rows.append((lens, parameter, replace(value, unit="")))
    return Table(
        columns=("Lens", "Parameter", Column(name="Value", key="value")),
        rows=rows,
        caption="Parameters of the calibration that counts, with the standard deviations it states.",
        note="Ideal to distorted, in mm from the principal point; x0, y0 from the centre of the detector.",
    )


def _map(outcome: Outcome, name: str) -> Pivot:
    """The maps themselves."""
    shown = ("error", "sigma", "corrected_error", "corrected_sigma", *outcome.labels("part"))
    lens = outcome.labels("camera")[name]
    return Pivot(
        rows=f"{name}_row {name}_column",
        hidden=f"{name}_row {name}_column",
        across="axis",
        columns=" ".join((f"{name}_map_px", *(f"{name}_{one}_arcsec" for one in shown))),
        caption=f"Line-of-sight error over the detector, {lens} lens: model minus traced lens.",
    )


def _stars(outcome: Outcome, name: str) -> Pivot:
    """Every star that was calibrated with."""
    kinds = ("measured", "own", "light", "reference", "residual")
    shown = ("frame", "id", "magnitude", "temperature", "snr", *(f"{kind}_px" for kind in kinds))
    return Pivot(
        rows=f"{name}_star",
        hidden=f"{name}_star",
        across="axis",
        columns=" ".join(f"{name}_star_{one}" for one in shown),
        caption=f"Stars calibrated with, {outcome.labels('camera')[name]} lens.",
        note="measured: PSF of one colour; own: PSF of the star's colour; light: centroid of the noiseless light; "
        "reference: where light of the reference colour would fall; residual: measured minus calibrated camera.",
    )
