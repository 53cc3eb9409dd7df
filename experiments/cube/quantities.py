"""The numbers of the cube-mirror experiment, each described once."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.cube.budget import (
    DETECTOR_RELATIVE,
    PICTURES_RELATIVE,
    PUBLISHED_ARCSEC,
    SENSOR_RELATIVE,
    face_angles_deg,
    reading_term,
)
from experiments.cube.independent import covariance_off, reading_effect_arcsec, written_out_off_arcsec
from experiments.cube.noise import sensor_noise
from experiments.cube.published import PUBLISHED_TRIMS, published_rates
from experiments.cube.result import Result, eq14_arcsec, sensor_error_arcsec, sigma1_arcsec
from experiments.harness.quantities import Quantities
from optics.arrays import FloatArray
from optics.units import DEG_RAD, RAD_ARCSEC, RAD_DEG

UNEQUAL_ARCSEC = (1.0, 3.0)
"""Readings of outer and inner axis that cannot be exchanged unnoticed."""

__all__ = ["describe", "trim_tables"]

XYZ = {"unit": "arcsec", "dims": "axis"}


def describe(result: Result) -> Quantities:
    """Quantities of a run; axes are those of the cube frame."""
    q, performed, reading = Quantities(), result.row("procedure"), result.cases["reading"]
    q.axis("axis", ["x", "y", "z"], "Axis")
    q.axis("case", list(result.cases), "Case")
    _trims(q, result)
    q.add(
        "r_sp_error_arcsec_1sigma",
        performed.measured_arcsec,
        "R_sp, as performed",
        **XYZ,
        error=performed.uncertainty_arcsec,
        n=performed.benches,
    )
    _budget(q, result)
    means = [case.mean_arcsec for case in result.cases.values()]
    q.add(
        "mean_error_arcsec",
        [mean for mean, _ in means],
        "Mean error of R_sp",
        unit="arcsec",
        dims="case axis",
        error=[sigma for _, sigma in means],
        n=[[len(case.bench)] * 3 for case in result.cases.values()],
    )
    mean, sigma = reading.sensor_mean_arcsec
    q.add("r_sr_mean_error_arcsec", mean, "Mean error of R_sr", **XYZ, error=sigma, n=len(result.truths))
    q.add("r_sr_error_over_stated", reading.sensor_pull, "Error of R_sr over the stated one", dims="axis")
    q.add("eq13_arcsec", sigma1_arcsec(result), "Eq. 13", unit="arcsec", format=".2f")
    q.add("eq14_arcsec", eq14_arcsec(result), "Eq. 14", unit="arcsec", format=".2f")
    check, bench = face_angles_deg()
    q.add("face_angle_check_deg", check, "Faces of Table 1 by eq. 8", unit="deg", format=".4f")
    q.add("face_angle_of_table1_in_this_bench_deg", bench, "The same on this bench", unit="deg", format=".4f")
    shown, true = result.shown.face_angle_rad * RAD_DEG, result.shown.true_face_angle_rad * RAD_DEG
    q.add("shown_face_deg", shown, "Faces", unit="deg", format=".5f", json="face_angle_shown_bench.measured_deg")
    q.add("true_face_deg", true, "Faces, true", unit="deg", format=".5f", json="face_angle_shown_bench.true_deg")
    _sensor(q, result)
    rates = (
        ("axes_out_of_square", result.lean_rate),
        ("beam_x", result.beam_rate[:, 0]),
        ("beam_y", result.beam_rate[:, 1]),
    )
    for name, rate in rates:
        q.add(f"rate_{name}", rate, "Error of R_sp per arcsec", dims="component", json=f"error_per_arcsec.{name}")
    light, again = result.light, result.repeatability
    q.add(
        "worst_displacement_um",
        light.worst_displacement_um,
        unit="um",
        format=".3f",
        json="light.worst_displacement_um",
    )
    q.add("worst_profile", light.worst_profile, format=".4f", json="light.worst_profile")
    for name, number in (
        ("two_pictures", again.two_px),
        ("one_picture", again.own_px),
        ("stated_by_the_fits", again.stated_px),
        ("stated_over_scatter", again.stated_over_scatter),
        ("pictures", again.pictures),
    ):
        unit = "" if name in ("stated_over_scatter", "pictures") else "px"
        q.add(f"repeatability_{name}", number, unit=unit, json=f"repeatability_px.{name}")
    _independent(q, result)
    q.add("benches", len(result.truths), "Benches")
    q.add("settings_per_face", float(result.cases["procedure"].trims.mean()), "Settings per face", format=".1f")
    _every_bench(q, result)
    _published_rates(q)
    return q


def _independent(q: Quantities, result: Result) -> None:
    """Noise predicted beside noise measured, and R_sp written out (`experiments.cube.noise`, `independent`)."""
    again, noise, reading = result.repeatability, result.picture_noise, result.cases["reading"]
    place = {"dims": "reduced", "json": "picture_noise_px[reduced]"}
    q.axis("reduced", ["two_pictures", "one_picture"])
    measured, predicted = np.array([again.two_px, again.own_px]), np.array([noise.two_px, noise.own_px])
    chance = 1.0 / np.sqrt(2 * 2 * (again.pictures - 1))  # two axes
    error = PICTURES_RELATIVE * predicted
    q.add("picture_noise_px", predicted, "Scatter of an offset, predicted", unit="px", error=error, **place)
    where = {"dims": "reduced", "json": "picture_noise_measured_over_predicted[reduced]"}
    ratio = measured / predicted
    q.add("picture_noise_ratio", ratio, "measured over predicted", error=chance, **where)
    measured = np.array([again.two_detector_px, again.own_detector_px])
    predicted = np.array([noise.two_detector_px, noise.own_detector_px])
    place = {"dims": "reduced", "json": "detector_noise_px[reduced]", "unit": "px", "format": ".4f"}
    error = DETECTOR_RELATIVE * predicted
    q.add("detector_noise_px", predicted, "The same by the detector alone, predicted", error=error, **place)
    where = {"dims": "reduced", "json": "detector_noise_measured_over_predicted[reduced]"}
    q.add("detector_noise_ratio", measured / predicted, "measured over predicted", error=chance, **where)
    sensor = sensor_noise(result.laboratory, reading=True, lean=False)
    predicted = np.sqrt(np.diag(sensor.covariance_rad2)) * RAD_ARCSEC
    place = {"dims": "axis", "unit": "arcsec"}
    q.add("r_sr_predicted_arcsec", predicted, "Error of R_sr, predicted", error=SENSOR_RELATIVE * predicted, **place)
    pulls = np.array([one.sensor_error_arcsec for one in reading.bench]) / predicted
    ratio = float(np.sqrt(np.mean(pulls**2)))
    q.add(
        "r_sr_error_over_predicted",
        ratio,
        "Error of R_sr over predicted",
        error=1 / np.sqrt(2 * pulls.size),
        n=pulls.size,
    )
    q.add(
        "spots_predicted_px",
        sensor.spot_px,
        "Scatter of the spots, predicted",
        unit="px",
        format=".4f",
        json="r_sr.spots_predicted_px",
    )
    outer, inner = UNEQUAL_ARCSEC
    off = np.abs(reading_term(outer, inner) / reading_effect_arcsec(outer, inner) - 1.0).max()
    q.add("reading_off", off, "Effect of readings, budget against differences", json="independent.reading_off")
    q.add(
        "covariance_off", covariance_off(), "Covariance of R_sp against differences", json="independent.covariance_off"
    )
    off = written_out_off_arcsec(result.config, result.truths[0], result.shown, result.shown_run)
    q.add("written_out_off_arcsec", off, "R_sp written out, off by", unit="arcsec", json="independent.r_sp_off_arcsec")


def _trims(q: Quantities, result: Result) -> None:
    """Trims of the shown bench, one after the other; in ``summary.json`` by face (`trim_tables`)."""
    rows = [(trim.face, number + 1, row) for trim in result.shown.trims for number, row in enumerate(trim.rows)]
    offset, sigma = np.array([row.offset_px for *_, row in rows]), np.array([row.sigma_px for *_, row in rows])
    q.add("trim_face", [face for face, *_ in rows], "Face", dims="setting", key="face", json="")
    q.add("trim", [number for _, number, _ in rows], "Trim", dims="setting", json="")
    for name, values in (
        ("Inner", [row.inner_deg for *_, row in rows]),
        ("Outer", [row.outer_deg for *_, row in rows]),
    ):
        key = f"{name.lower()}_deg"
        q.add(f"trim_{key}", values, name, unit="deg", dims="setting", format=".4f", key=key, json="")
    q.add(
        "trim_offset_px",
        offset,
        "Offset",
        unit="px",
        dims="setting direction",
        error=sigma,
        key="offset_{direction}_px",
        json="",
    )
    q.axis("direction", ["x", "y"])


def trim_tables(result: Result) -> dict[str, Any]:
    """Trims by face, for ``summary.json``."""
    names = ("outer_deg", "inner_deg", "x_px", "y_px", "sigma_x_px", "sigma_y_px")
    return {
        "trim_tables": {
            trim.face: [
                dict(zip(names, (row.outer_deg, row.inner_deg, *row.offset_px, *row.sigma_px), strict=True))
                for row in trim.rows
            ]
            for trim in result.shown.trims
        }
    }


def _budget(q: Quantities, result: Result) -> None:
    """Term by term: predicted by geometry, measured on the benches."""
    rows = result.budget
    q.add("term", [row.name for row in rows], dims="row", json="budget[row].term")
    q.add("meaning", [row.label for row in rows], "Term", dims="row", key="term", json="budget[row].meaning")
    published = [PUBLISHED_ARCSEC.get(row.name, np.nan) for row in rows]
    place = {"dims": "row", "unit": "arcsec", "format": ".2f"}
    q.add("published_arcsec", published, "CUBE09", **place, json="budget[row].published_arcsec")
    angle = {"unit": "arcsec", "dims": "row axis", "format": ".2f"}
    unknown = np.full((len(rows), 3), np.nan)
    off = [row.predicted_sigma_arcsec for row in rows]
    predicted, alone = [row.predicted_arcsec for row in rows], [row.term_arcsec for row in rows]
    q.add("predicted", predicted, "pred.", **angle, error=off, json="budget[row].predicted")
    q.add("predicted_alone", alone, "alone", **angle, error=unknown, json="budget[row].predicted_term_alone")
    q.add(
        "measured",
        [row.measured_arcsec for row in rows],
        "meas.",
        **angle,
        error=[row.uncertainty_arcsec for row in rows],
        n=[[row.benches] * 3 for row in rows],
        json="budget[row].measured",
    )
    acts = [row.acts for row in rows]
    q.add("acts_on", acts, "Acts on", dims="row axis", json="budget[row].acts_on")
    ratio, sigma = [row.ratio for row in rows], [row.ratio_sigma for row in rows]
    where = "budget[row].predicted_over_measured"
    q.add("predicted_over_measured", ratio, "Ratio", dims="row", format=".3f", json=where)
    q.add("predicted_over_measured_sigma", sigma, dims="row", json=f"{where}_sigma")


def _sensor(q: Quantities, result: Result) -> None:
    """The sun sensor of the shown bench."""
    sensor = result.shown.sensor
    q.add("r_sr_arcsec", sensor.rotation.as_rotvec() * RAD_ARCSEC, dims="component", json="r_sr.rotation_vector_arcsec")
    covariance: FloatArray = sensor.covariance_rad2 * RAD_ARCSEC**2
    q.add("r_sr_covariance_arcsec2", covariance, dims="component other", json="r_sr.covariance_arcsec2")
    q.add("r_sr_error_arcsec", sensor_error_arcsec(result), unit="arcsec", dims="component", json="r_sr.error_arcsec")
    q.add("spots_rms_px", sensor.sigma_px, "Scatter of the spots", unit="px", format=".4f", json="r_sr.spots_rms_px")
    q.add("positions", len(result.shown_run.pixel_px), "Positions of the table", json="r_sr.positions")
    q.add("mask_gap_mm", sensor.focal_length_mm, unit="mm", json="r_sr.mask_gap_mm")
    q.axis("angle", ["azimuth", "elevation"])
    free, sigma = sensor.free_beam_rad * RAD_ARCSEC, sensor.free_beam_sigma_rad * RAD_ARCSEC
    q.add("free_beam_arcsec", free, "Beam off the Z axis", unit="arcsec", dims="angle", error=sigma, json="")
    lean = np.mean([bench.sensor.lean_sigma_rad for bench in result.cases["improved"].bench]) * RAD_ARCSEC
    q.add("squareness_sigma_arcsec", lean, "Squareness known to", unit="arcsec", format=".2f", json="")
    q.add("mask_gap_true_mm", result.truths[0].sensor.gap_mm, unit="mm", json="r_sr.mask_gap_true_mm")


def _every_bench(q: Quantities, result: Result) -> None:
    cases = result.cases.values()
    q.axis("bench", [truth.number for truth in result.truths], "Bench")
    errors = [[bench.error_arcsec for bench in case.bench] for case in cases]
    key = "error_{axis}_arcsec"
    q.add("bench_error", errors, "Error", unit="arcsec", dims="case bench axis", key=key, json="")
    for name, place in (("first", 0), ("second", -1)):
        counts = [[len(bench.trims[place].rows) for bench in case.bench] for case in cases]
        key = f"settings_{name}"
        q.add(key, counts, f"Settings, {name} face", dims="case bench", json="")


def _published_rates(q: Quantities) -> None:
    """What the printed trims say of the size of a pixel: motion of the spot per 0.001 deg."""
    expected = 2 * np.tan(0.001 * DEG_RAD) * 650 / 0.015  # 650 mm, 15 um pixels
    first, second, third = PUBLISHED_TRIMS["XY"][:3]
    slopes = np.array([(first[3] - second[3]) / 10, (second[3] - third[3]) / 8])
    rates = published_rates()
    slow = np.any((rates > 0.8 * slopes.min()) & (rates < 1.4 * slopes.max()), axis=1)
    q.add("expected_rate", expected, unit="px", json="")
    q.add("published_rate", slopes, unit="px", dims="move", json="")
    q.add("published_moves", len(rates), json="")
    q.add("slow_moves", int(slow.sum()), json="")
    q.add("nearest_rate", rates.ravel()[np.argmin(np.abs(rates - expected))], unit="px", json="")
