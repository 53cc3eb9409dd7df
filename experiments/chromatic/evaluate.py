"""Reduction of the chromatic test: ACC18's statistic, uncertainties, comparison with truth and prediction, criteria."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import norm

from experiments.chromatic.result import Result
from experiments.harness.summary import Criterion, Measured
from experiments.laboratory.chromatic_error import ChromaticReduction, rms
from optics.arrays import FloatArray
from optics.rays.pupil import entrance_pupil

__all__ = ["criteria", "lsfe_arcsec", "results", "rule_of_third"]


SIGMA_LIMIT = 3.0


def lsfe_arcsec(result: Result, evaluation: ChromaticReduction) -> tuple[Measured, Measured]:
    """ACC18's chromatic LSFE per axis, 3 sigma: the largest entry of Table 1, divided by 3, times 3, in arcsec."""
    scale = result.instrument.pixel_arcsec
    out = []
    for axis in range(2):
        name = max(evaluation.table1_px, key=lambda n: abs(evaluation.table1_px[n][axis]))
        value, sigma = abs(evaluation.table1_px[name][axis]), evaluation.table1_sigma_px[name][axis]
        count = result.config.frames * int(np.prod(evaluation.shift_px[name].shape[:2]))
        out.append(Measured(value=float(value * scale), unit="arcsec", uncertainty=float(sigma * scale), n=count))
    return out[0], out[1]


def rule_of_third(result: Result) -> dict[str, float]:
    """A third of the halved filter shift of a point [px], RMS and largest over the same places where the stars are."""
    length = [np.linalg.norm(shift, axis=-1) for shift in result.field_shift_px.values()]
    return {
        "one third of half the RMS filter shift": float(max(np.sqrt((v**2).mean()) for v in length) / 6.0),
        "one third of half the largest filter shift": float(max(v.max() for v in length) / 6.0),
    }


def _pull(evaluation: ChromaticReduction, against: Mapping[str, FloatArray]) -> float:
    """Largest distance of a Table 1 entry from another value, in standard deviations."""
    return float(
        max(
            np.abs((evaluation.table1_px[n] - against[n]) / evaluation.table1_sigma_px[n]).max()
            for n in evaluation.table1_px
        )
    )


def _two_sided_limit(count: int, false_alarm: float = 0.01) -> float:
    """Standard deviations that the largest of ``count`` normal deviates exceeds with probability ``false_alarm``."""
    return float(norm.isf(false_alarm / (2 * count)))


def criteria(result: Result) -> list[Criterion]:
    """What has to hold for the run to count as passed.

    With 3 sigma for each of eight entries of Table 1, one seed in fifty fails by chance.
    """
    both = (("centred lens", result.centred), ("moved element", result.moved))
    found: list[Criterion] = []
    for label, evaluation in both:
        found += [
            Criterion(
                name=f"{label}: Table 1 measured against noiseless photon centroid",
                value=_pull(evaluation, evaluation.photon_table1_px),
                limit=SIGMA_LIMIT,
                unit="sigma",
            ),
            Criterion(
                name=f"{label}: Table 1 measured against ray-trace prediction",
                value=_pull(evaluation, evaluation.predicted_table1_px),
                limit=SIGMA_LIMIT,
                unit="sigma",
            ),
            Criterion(
                name=f"{label}: largest deviation of a single shift from the noiseless light",
                value=evaluation.largest_pull,
                limit=_two_sided_limit(evaluation.chi2_n),
                unit="sigma",
            ),
            Criterion(
                name=f"{label}: mean squared deviation in units of its variance, off 1 by",
                value=abs(evaluation.chi2 - 1.0),
                # the two pairs share the reference band, so their pulls are correlated by 1/2
                limit=4.0 * float(np.sqrt(2.5 / evaluation.chi2_n)),
            ),
            Criterion(
                name=f"{label}: light on the detector, before pixels, against the traced bundle",
                value=float(np.nanmax(np.abs(evaluation.measurement.photon_px - evaluation.measurement.bundle_px))),
                limit=1e-4,
                unit="px",
            ),
        ]
        if entrance_pupil(result.instrument.camera.lens).exact:  # otherwise both are Sobol sums, good to some 1e-3 px
            found.append(
                Criterion(
                    name=f"{label}: noiseless light against ray-trace prediction, largest shift",
                    value=max(
                        float(np.abs(evaluation.photon_shift_px[n] - evaluation.predicted_shift_px[n]).max())
                        for n in evaluation.photon_shift_px
                    ),
                    limit=1e-4,
                    unit="px",
                )
            )
    wanted, axis = result.config.decentre, "xy".index(result.config.decentre.axis)
    reached = result.moved.table1_px[wanted.pair][axis] - wanted.wanted_px
    found.append(
        Criterion(
            name=f"moved element: the wanted {wanted.wanted_px:g} px is measured",
            value=float(abs(reached) / result.moved.table1_sigma_px[wanted.pair][axis]),
            limit=SIGMA_LIMIT,
            unit="sigma",
        )
    )
    return found


def _xy(values: FloatArray) -> dict[str, float]:
    return {"x": float(values[0]), "y": float(values[1])}


def _evaluation_summary(result: Result, evaluation: ChromaticReduction) -> dict[str, Any]:
    count = result.config.frames * int(np.prod(evaluation.measurement.nominal_px.shape[:2]))
    return {
        "table1_px": {n: _xy(v) for n, v in evaluation.table1_px.items()},
        "table1_sigma_px": {n: _xy(v) for n, v in evaluation.table1_sigma_px.items()},
        "table1_n": count,
        "predicted_table1_px": {n: _xy(v) for n, v in evaluation.predicted_table1_px.items()},
        "photon_table1_px": {n: _xy(v) for n, v in evaluation.photon_table1_px.items()},
        "bundle_table1_px": {n: _xy(v) for n, v in evaluation.bundle_table1_px.items()},
        "rms_shift_px": {n: _xy(rms(v)) for n, v in evaluation.shift_px.items()},
        "residual_after_calibration_px": {
            n: {k.replace(" ", "_"): v for k, v in steps.items()} for n, steps in evaluation.residual_px.items()
        },
        "photon_residual_after_calibration_px": {
            n: {k.replace(" ", "_"): v for k, v in steps.items()} for n, steps in evaluation.photon_residual_px.items()
        },
        "truth_bias_px": {"max": evaluation.truth_bias_px[0], "rms": evaluation.truth_bias_px[1]},
        "mean_squared_pull": evaluation.chi2,
        "largest_pull": evaluation.largest_pull,
    }


def _methods_summary(evaluation: ChromaticReduction) -> dict[str, Any]:
    """Table 1 by every centroider."""
    return {m: {n: _xy(v) for n, v in entries.items()} for m, entries in evaluation.method_table1_px.items()}


def results(result: Result) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    x, y = lsfe_arcsec(result, result.centred)
    moved_x, moved_y = lsfe_arcsec(result, result.moved)
    chosen = result.chosen
    centred = _evaluation_summary(result, result.centred)
    return {
        **centred,
        "lsfe_s_arcsec_3sigma": {"x": x, "y": y},
        "stellar": {
            "reference_k": result.config.stars.reference_k,
            "temperature_k": result.stellar.temperature_k,
            "rms_shift_px": result.stellar.rms_px,
            "max_shift_px": result.stellar.max_px,
            "most_different_rms_px": result.stellar.most_different_rms_px,
            "one_third_rule_px": {k.replace(" ", "_"): v for k, v in rule_of_third(result).items()},
            "moved_element": {
                "mean_shift_px": result.moved_stellar.mean_px,
                "rms_shift_px": result.moved_stellar.rms_px,
                "most_different_rms_px": result.moved_stellar.most_different_rms_px,
            },
        },
        "method_table1_px": _methods_summary(result.centred),
        "decentre_solution": {
            "element": chosen.element,
            "kind": chosen.kind,
            "amount": chosen.amount,
            "unit": chosen.unit,
            "wanted_px": result.config.decentre.wanted_px,
            "lsfe_s_arcsec_3sigma": {"x": moved_x, "y": moved_y},
            "measured": _evaluation_summary(result, result.moved),
            "method_table1_px": _methods_summary(result.moved),
            "all_elements": [
                {
                    "element": s.element,
                    "kind": s.kind,
                    "amount": s.amount,
                    "unit": s.unit,
                    "table1_px": {n: _xy(v) for n, v in s.table1_px.items()},
                    "boresight_px": _xy(s.boresight_px),
                }
                for s in result.solutions
            ],
        },
        "signal_of_v7_5_star_e": result.star_e,
        "pixel_arcsec": result.instrument.pixel_arcsec,
        "rms_spot_um": dict(
            zip(
                (f"{c:g}" for c in result.config.filters.centres_nm),
                result.centred.measurement.rms_spot_um,
                strict=True,
            )
        ),
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }
