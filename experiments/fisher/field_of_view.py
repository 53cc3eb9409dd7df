"""Bias of the pixel-residual method for star vectors over the field of view, against its closed forms.

The equations are in `calib.directional.pixel_method`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.attitude.star_vectors import sampled_method_ratios
from calib.cameras import BrownConrady, SensorGeometry
from calib.directional.pixel_method import pixel_noise_ratio, spherical_noise_ratio, vectors_needed
from experiments.fisher.settings import FieldConfig
from experiments.harness.drawings import curves
from experiments.harness.sections import Section, agree, col
from experiments.harness.summary import Measured
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

SWEEP_PX, SWEEP_PITCH_MM = 2048, 0.0055
"""Detector of the ideal cameras: pixels along each side, and their pitch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPoint:
    """Ideal camera of a square field, calibration known: ratios of standard deviations minus 1, in percent."""

    field_deg: float = col("Field", "deg", "g")
    # Noise isotropic on the sphere: pixel method over Fisher on the same vectors, Fisher over the truth
    pixel_method_bias_percent: Measured = col("Pixel method", "percent")
    closed_form_percent: float = col("closed form", "percent", ".4f")
    fisher_bias_percent: Measured = col("Fisher", "percent")
    vectors_needed: float = col("Vectors to detect it", format=".2g")
    # Noise isotropic in pixels: Fisher over the pixel method, which gives the noise on the axis, on the same images
    pixel_noise_fisher_percent: Measured = col("Pixel noise", "percent")
    pixel_noise_quadrature_percent: float = col("quadrature", "percent", ".4f")


def field_sweep(config: FieldConfig, streams: Streams, *, advance: Callable[[], None]) -> list[FieldPoint]:
    """Monte-Carlo over fields: ideal cameras with known calibration, vectors spread evenly over the detector."""
    points = []
    for field in config.field_deg:
        points.append(_field_point(config, field, streams.child("field", f"{field:g}")))
        advance()
    return points


def _field_point(config: FieldConfig, field_deg: float, streams: Streams) -> FieldPoint:
    """Both methods on vectors of noise isotropic on the sphere, and on images of noise isotropic in pixels."""
    geometry = SensorGeometry(width_px=SWEEP_PX, height_px=SWEEP_PX, pixel_pitch_mm=SWEEP_PITCH_MM)
    model = BrownConrady.of_field(geometry, field_deg)
    sigma = config.sigma_arcsec * ARCSEC_RAD
    runs = [
        sampled_method_ratios(model, config.directions, sigma, streams.generator("vectors", run))
        for run in range(config.runs)
    ]
    baseline, fisher, pixel_noise = np.transpose(runs)
    excess = spherical_noise_ratio(field_deg) - 1.0
    return FieldPoint(
        field_deg=field_deg,
        pixel_method_bias_percent=_percent_above_one(baseline),
        closed_form_percent=100.0 * excess,
        fisher_bias_percent=_percent_above_one(fisher),
        vectors_needed=vectors_needed(excess),
        pixel_noise_fisher_percent=_percent_above_one(pixel_noise),
        pixel_noise_quadrature_percent=100.0 * (pixel_noise_ratio(field_deg) - 1.0),
    )


def _percent_above_one(ratios: Sequence[float]) -> Measured:
    """Mean over runs of a ratio of standard deviations, less 1 [percent], with its standard error."""
    error = float(np.std(ratios, ddof=1)) / float(np.sqrt(len(ratios)))
    return Measured(value=100.0 * (float(np.mean(ratios)) - 1.0), unit="percent", uncertainty=100.0 * error)


FIELDS = Section(
    record=FieldPoint,
    dim="field",
    along="field_deg",
    table="field_of_view",
    caption="Bias of the standard deviation by method, against the width of a square field.",
    note="Ideal cameras, known calibration, vectors evenly over the detector; ± 1 standard error. "
    "Noise isotropic on the sphere: pixel method / Fisher − 1; Fisher / truth; number of "
    "vectors at which the 95 % interval of σ is as narrow as the bias. Pixel noise (isotropic "
    "in pixels): Fisher / pixel method − 1.",
    figures={
        "field_bias": curves(
            "field_deg",
            points="pixel_method_bias_percent pixel_noise_fisher_percent",
            lines="closed_form_percent pixel_noise_quadrature_percent",
            log="x",
            y="Ratio of the methods' σ, minus 1",
        )
    },
    verdicts=[
        agree(  # Normal probability; by Student's t of 20 to 40 runs the false-alarm probability is 0.2 to 0.7 %
            "pixel_method_bias_percent",
            with_="closed_form_percent",
            title="bias of the pixel method against its closed form",
            false_alarm=0.001,
        ),
        agree(
            "pixel_noise_fisher_percent",
            with_="pixel_noise_quadrature_percent",
            title="noise isotropic in pixels: Fisher over pixel method against quadrature",
            false_alarm=0.001,
        ),
    ],
)
