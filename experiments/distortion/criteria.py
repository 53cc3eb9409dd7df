"""What has to hold for a distortion test to count as passed."""

from __future__ import annotations

import numpy as np

from experiments.harness.quantities import Outcome
from experiments.harness.summary import Criterion, farthest_from_one
from experiments.laboratory.criteria import centroids_on_the_light, pixel_angle
from experiments.laboratory.distortion_statistics import REFERENCES

__all__ = ["criteria"]


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
    found.append(pixel_angle(outcome.result.instrument))
    measured = outcome.result.measured
    test = {method: measured.session_px[method][1] for method in config.methods}
    return [*found, *centroids_on_the_light("", test, measured.light.photon_px)]
