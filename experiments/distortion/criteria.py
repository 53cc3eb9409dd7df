"""What has to hold for a distortion test to count as passed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.laboratory import as_printed
from experiments.laboratory.criteria import as_the_paper, centroids_on_the_light, pixel_angle
from experiments.laboratory.distortion_statistics import REFERENCES
from experiments.laboratory.target import nudged
from optics.arrays import FloatArray

__all__ = ["criteria", "wide_criteria"]


def criteria(outcome: Outcome) -> list[Criterion]:
    """The document's numbers against their prediction, and the true map against its forecast."""
    found, config = [], outcome.config
    sampling = float(np.sqrt(1.0 / (18.0 * config.surveys)))  # of an RMS over surveys, each of about nine coefficients
    for method in config.methods:
        for reference in REFERENCES:
            one, expected, spread = (
                outcome.values(f"{name}_arcsec", method=method, reference=reference)
                for name in ("one_survey", "predicted", "predicted_scatter")
            )
            found.append(
                Criterion(
                    name=f"{method}, {reference}: found, left and removed against prediction, one survey, largest "
                    "deviation",
                    value=float(np.abs((one - expected) / spread).max()),
                    limit=4.0,
                    unit="sigma",
                )
            )
        rms, expected = (
            outcome.values(name, method=method, reference=config.reference)
            for name in ("all_surveys_arcsec", "predicted_arcsec")
        )
        pull = (rms - expected) / outcome.errors("predicted_arcsec", method=method, reference=config.reference)
        found.append(
            Criterion(
                name=f"{method}, {config.reference}: RMS over surveys against prediction, largest deviation",
                value=float(np.abs(pull).max()),
                limit=4.0,
                unit="sigma",
            )
        )
    nominal, aligned = (
        outcome.values("one_survey_arcsec", method=config.methods[0], reference=reference, number="sigma_left")
        for reference in ("nominal", "aligned")
    )
    found.append(
        Criterion(
            name="what is left does not depend on scale, roll and shift of the coordinates",
            value=float(np.abs(nominal - aligned).max()),
            limit=1e-3,
            unit="arcsec",
        )
    )
    seen = outcome.values("map_all_surveys_arcsec", reference="aligned")
    found.append(
        Criterion(
            name="true map error of all surveys over its forecast",
            value=farthest_from_one(seen / outcome.values("forecast_arcsec")),
            about=1.0,
            limit=0.1 + 3.0 * sampling,
        )
    )
    return [*found, *wide_criteria(outcome), *_end_to_end(outcome)]


def _end_to_end(outcome: Outcome) -> list[Criterion]:
    """By paths that share no equation with the reduction: known errors, the printed equations, the light itself."""
    config, measured, instrument = outcome.config, outcome.result.measured, outcome.result.instrument
    test = {method: measured.session_px[method][1] for method in config.methods}
    direction, camera = measured.surveyed[0], instrument.camera
    scale = instrument.focal_length_mm / camera.pixel_pitch_mm
    coordinate = camera.centre_px + scale * np.column_stack([direction[:, k] / direction[:, 2] for k in (0, 1)])
    stated = outcome.value("pixel_arcsec")
    reported = [outcome.values("one_survey_arcsec", method=m, reference="nominal") for m in config.methods]
    printed = [as_printed.distortion_arcsec(test[m], coordinate, config.order, stated) for m in config.methods]
    found = [as_the_paper("σδ, σΔδ, σC1 of one survey, nominal coordinates", reported, printed, "arcsec")]
    if 2 * len(coordinate) >= (config.order + 2) * (config.order + 3):  # enough for one degree more
        found.append(_bent_target(outcome, coordinate))
    return [*found, pixel_angle(instrument), *centroids_on_the_light("", test, measured.light.photon_px)]


def _bent_target(outcome: Outcome, coordinate_px: FloatArray) -> Criterion:
    """The reduction with target coordinates (n, 2) that are wrong by known polynomials.

    In x by one of the fitted degree that is orthogonal to all lower ones, in y by one of the next degree that is so:
    all of the first is removed, all of the second is left. Bent both ways, the mean of the squares less the square
    without has no product of the bend with anything else.
    """
    measured, order = outcome.result.measured, outcome.config.order
    size_px, points = np.array([1.0, 0.5]), len(coordinate_px)
    x, y = ((coordinate_px - coordinate_px.mean(0)) / np.ptp(coordinate_px, axis=0)).T
    bend = np.empty((points, 2))
    for axis, degree in enumerate((order, order + 1)):
        lower = np.column_stack([x**a * y**b for a in range(degree) for b in range(degree - a)])
        new = x**degree - lower @ np.linalg.lstsq(lower, x**degree, rcond=None)[0]
        bend[:, axis] = size_px[axis] * new / np.sqrt((new**2).mean())
    square = []
    for way in (1.0, -1.0, 0.0):
        surveyed = nudged(outcome.result.instrument, measured.surveyed[0], way * bend)[None]
        one = replace(measured, surveyed=surveyed).statistics(outcome.config.methods[0], "nominal")
        square.append(np.array([one.sigma_d_px, one.sigma_left_px, one.sigma_c1_px]) ** 2)
    grown = (0.5 * (square[0] + square[1]) - square[2]) * (points - 1.0) / (points * size_px**2)
    return Criterion(
        name=f"target bent by a polynomial of degree {order} in x, {order + 1} in y: its share (x y) in σδ² is 1 1, "
        "in σΔδ² 0 1, in σC1² 1 0; largest difference",
        value=float(np.abs(grown - np.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]])).max()),
        limit=0.01,
    )


def wide_criteria(outcome: Outcome) -> list[Criterion]:
    """The rendered distortion against the prescription, where it is what the numbers consist of."""
    wide = outcome.result.wide
    apart, expected = wide.points_px
    freedom = apart.size - 4  # shift, roll and scale are fitted
    return [
        Criterion(
            name="wide field: found, left and removed against the prescription, largest deviation",
            value=float(np.abs((wide.numbers_px - wide.expected_px) / wide.scatter_px).max()),
            limit=4.0,
            unit="sigma",
        ),
        Criterion(
            name="wide field: residuals minus those of the prescription, RMS over points in units of its expectation",
            value=float(np.sqrt((apart**2).sum() / (expected**2).mean() / freedom)),
            about=1.0,
            limit=float(f"{4.0 / np.sqrt(2.0 * freedom):.2g}"),
        ),
        Criterion(
            name="wide field: what marking errors alone give of what is removed, largest share",
            value=float((wide.marking_px / wide.expected_px)[2].max()),
            limit=0.05,
        ),
    ]
