"""Camera report: predicted performance, requirements, the most effective change, and frames that confirm it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.camera.answer import Swing, Temperatures, ThermalRange, limits
from experiments.camera.comparison import FRAMES, SOLVED
from experiments.camera.guides import COVERAGE, LOST_IN_SPACE, coverage
from experiments.camera.manufacture import MANUFACTURED, RENDERED_LENSES
from experiments.camera.operation import LIFE, MOTION
from experiments.camera.settings import CameraReportConfig
from experiments.harness.drawings import bars, curves
from experiments.harness.plotting import INK, PALETTE, new_figure
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, col, numbers_of
from experiments.harness.what_if import REQUIREMENTS, Requirement, judge, missed_words
from experiments.laboratory.sensor_prediction import (
    CameraPrediction,
    Optics,
    SkyPerformance,
    StarAccuracy,
    predict_camera,
)
from optics.arrays import FloatArray
from optics.figures import draw_lens, draw_spots
from optics.rays.performance import LensPerformance
from render.field_response import FieldResponse

__all__ = ["SECTIONS", "predict", "predicted"]

CURVE_POINTS = 91
"""Magnitudes of a curve."""
RADIUS_STEPS = 8
"""Positions along each side of the detector, over which curves against magnitude are averaged."""
DRAWN_FIELDS = (0, 2, 4)
"""Rows of the traced fields (`render.sensor.FIELD_FRACTIONS`): axis, 0.7 of the half diagonal, corner."""
DRAWN_WAVELENGTHS = (0, 2, 5)
"""Rows of the traced wavelengths in spot diagrams."""


# --- Description of the sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSummary:
    """Sensor and requirements in words, and the prediction."""

    name: str = col("Sensor")
    lens: str = col("Lens")
    detector: str = col("Detector")
    answer: str = col("Requirements in a sentence")
    requirements_missed: int = col("Requirements that are missed")
    prediction: CameraPrediction


def summarise_sensor(prediction: CameraPrediction, requirements: Sequence[Requirement]) -> SensorSummary:
    """Summary of the sensor."""
    lens = prediction.state.sensor.camera.lens.name
    detector = prediction.detector.name
    return SensorSummary(
        name=prediction.config.name or f"{lens} on {detector}",
        lens=lens,
        detector=detector,
        answer=missed_words(requirements),
        requirements_missed=sum(not requirement.met for requirement in requirements),
        prediction=prediction,
    )


def draw_lens_section(outcome: Outcome) -> Figure:
    """Cross-section of the lens with fans of rays to three fields; of a measured lens, light and PSF over the field."""
    response: FieldResponse = outcome.result["setup"].prediction.state
    performance, camera = response.performance, response.sensor.camera
    field_deg = performance.field_deg
    if camera.lens.measured is not None:
        figure, (light, width) = new_figure(1, 2, aspect_ratio=0.38)
        light.plot(field_deg, performance.vignetting, "o-")
        light.set(xlabel="Field [°]", ylabel="Light of a star, relative to the axis", ylim=(0.0, None))
        width.plot(field_deg, performance.white.rms_mm() * 1e3, "o-")
        width.set(xlabel="Field [°]", ylabel="RMS radius of the PSF [µm]", ylim=(0.0, None))
        return figure
    figure = draw_lens(camera.focused_lens, fields_deg=field_deg[[*DRAWN_FIELDS]].tolist())
    figure.axes[0].set_title("")
    width, height = figure.get_size_inches()
    figure.set_size_inches(7.6, 7.6 * height / width)
    return figure


def draw_spots_over_field(outcome: Outcome) -> Figure:
    """Rays of the pass band at three fields, and a pixel of the detector."""
    response: FieldResponse = outcome.result["setup"].prediction.state
    camera, performance = response.sensor.camera, response.performance
    fields_deg = [(float(angle), 0.0) for angle in performance.field_deg[[*DRAWN_FIELDS]]]
    wavelength_nm = performance.wavelength_nm[[*DRAWN_WAVELENGTHS]].tolist()
    pixel_um = 1e3 * camera.pixel_pitch_mm
    return draw_spots(camera.focused_lens, fields_deg=fields_deg, wavelength_nm=wavelength_nm, pixel_um=pixel_um)


# --- Over the field


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPerformance:
    """Lens over the field: spot and focus (both polychromatic), distortion, vignetting, chromatic aberrations."""

    spot_um: FloatArray = col("RMS spot radius", "um", ".2f", "field")
    focus_um: FloatArray = col("Best focus", "um", ".1f", "field")
    distortion_percent: FloatArray = col("Distortion", "percent", ".3f", "field")
    vignetting_percent: FloatArray = col("Vignetting", "percent", ".1f", "field")
    lateral_colour_px: FloatArray = col("Lateral colour", "px", ".3f", "field wavelength", shown=False)
    axial_focus_um: FloatArray = col("Best focus on axis", "um", ".1f", "wavelength", shown=False)
    performance: LensPerformance


def tabulate_fields(prediction: CameraPrediction) -> FieldPerformance:
    """The traced performance of the lens in the units of the report."""
    performance = prediction.state.performance
    return FieldPerformance(
        spot_um=1e3 * performance.white.rms_mm(),
        focus_um=1e3 * performance.white.best_mm,
        distortion_percent=100.0 * performance.distortion,
        vignetting_percent=100.0 * (1.0 - performance.vignetting),
        lateral_colour_px=performance.lateral_colour_mm / prediction.state.sensor.camera.pixel_pitch_mm,
        axial_focus_um=1e3 * performance.axial_colour_mm,
        performance=performance,
    )


def field_axes(q: Quantities, fields: FieldPerformance) -> None:
    """Field angles and wavelengths of the trace."""
    q.axis("field", fields.performance.field_deg, "Field", unit="deg", format=".2f")
    q.axis("wavelength", fields.performance.wavelength_nm, "Wavelength", unit="nm", format=".0f")


# --- Against magnitude


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnitudeCurves:
    """Electrons, detection and accuracy of a star against magnitude, mean over the detector; NaN where it saturates."""

    electrons_e: FloatArray = col("Electrons", "e-", ".0f", "colour magnitude", shown=False)
    nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "magnitude")
    nea_bound_arcsec: FloatArray = col("Cramér-Rao bound of the NEA", "arcsec", ".3f", "magnitude")
    single_star_arcsec: FloatArray = col("Single-star accuracy", "arcsec", ".3f", "magnitude")
    detected_fraction: FloatArray = col("Fraction of stars detected", "", ".3f", "magnitude")
    magnitude_mag: FloatArray
    colours_k: Sequence[float]


def sweep_magnitude(prediction: CameraPrediction) -> MagnitudeCurves:
    """Curves from above the saturation limit to one magnitude below the limiting magnitude."""
    response, stars = prediction.state, prediction.stars
    star = prediction.config.star
    saturation = prediction.value("saturation_mag")
    faintest = prediction.value("limiting_magnitude_mag") + 1.0
    magnitude = np.linspace(min(saturation - 0.5, faintest - 2.0), faintest, CURVE_POINTS)
    camera = response.sensor.camera
    fraction = (np.arange(RADIUS_STEPS) + 0.5) / RADIUS_STEPS - 0.5  # of the sides, from the centre
    radius_px = np.hypot(*np.meshgrid(fraction * camera.width_px, fraction * camera.height_px)).ravel()
    electrons = [prediction.electrons(np.full(len(radius_px), m), star.temperature_k, radius_px) for m in magnitude]

    def rms_arcsec(sigma_px: FloatArray) -> FloatArray:
        rms = [float(np.sqrt((stars.sigma_at(sigma_px, e, radius_px) ** 2).mean())) for e in electrons]
        return np.where(magnitude < saturation, np.nan, response.pixel_arcsec * np.array(rms))

    return MagnitudeCurves(
        electrons_e=np.stack([prediction.electrons(magnitude, colour_k) for colour_k in star.colours_k]),
        nea_arcsec=rms_arcsec(stars.centroid.noise_px),
        nea_bound_arcsec=rms_arcsec(stars.centroid.bound_px),
        single_star_arcsec=np.hypot(
            rms_arcsec(stars.centroid.total_px), np.nan_to_num(prediction.value("colour_arcsec"))
        ),
        detected_fraction=np.array([float(stars.detected_at(e, radius_px).mean()) for e in electrons]),
        magnitude_mag=magnitude,
        colours_k=star.colours_k,
    )


def magnitude_axes(q: Quantities, magnitudes: MagnitudeCurves) -> None:
    """Magnitudes and colours of the curves."""
    q.axis("magnitude", magnitudes.magnitude_mag, "Magnitude", unit="mag", format=".2f")
    q.axis("colour", np.array(magnitudes.colours_k), "Star", unit="K", format=".0f")


# --- Over the sky


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSamples:
    """Prediction at the sampled attitudes."""

    samples: int = col("Attitudes")
    stars: FloatArray = col("Stars per frame", dims="attitude")
    cross_arcsec: FloatArray = col("Attitude across, 1σ", "arcsec", dims="attitude")
    roll_arcsec: FloatArray = col("Attitude roll, 1σ", "arcsec", dims="attitude")


def sample_attitudes(prediction: CameraPrediction) -> AttitudeSamples:
    """Stars and errors of every attitude; errors are infinite where too few stars are detected."""
    forecast = prediction.attitude
    return AttitudeSamples(
        samples=len(forecast.stars),
        stars=forecast.stars,
        cross_arcsec=np.sqrt((forecast.total_arcsec[:, :2] ** 2).mean(axis=1)),
        roll_arcsec=forecast.total_arcsec[:, 2],
    )


def draw_sky(outcome: Outcome) -> Figure:
    """Stars per frame, attitude across and roll over the sky, worst 1 % marked."""
    figure, axes = new_figure(1, 3, aspect_ratio=0.34)
    for panel, name, worst, colour in (
        (axes[0], "attitudes.stars", "stars_worst_per_frame", PALETTE[2]),
        (axes[1], "attitudes.cross_arcsec", "attitude_cross_worst_arcsec", PALETTE[0]),
        (axes[2], "attitudes.roll_arcsec", "attitude_roll_worst_arcsec", PALETTE[1]),
    ):
        values = outcome.values(name)
        finite, worst_value = values[np.isfinite(values)], outcome.value(worst)
        if finite.size:
            top = float(np.quantile(finite, 0.995)) * 1.1
            panel.hist(np.clip(finite, None, top), bins=28, color=colour, alpha=0.7)
            panel.margins(y=0.3)  # for the label above the bars
        if np.isfinite(worst_value):
            panel.axvline(worst_value, color=INK, linewidth=0.9, dashes=(4, 3))
            panel.annotate("worst 1 %", (worst_value, 0.97), xycoords=("data", "axes fraction"), xytext=(3, 0),
                           textcoords="offset points", va="top", fontsize=7.5, rotation=90)  # fmt: skip
        panel.set(xlabel=outcome.heading(name), yticks=[])
        panel.spines["left"].set_visible(False)
    axes[0].set_ylabel("attitudes")
    return figure


def temperature_axis(q: Quantities, temperatures: Temperatures) -> None:
    """Temperatures of lens and housing."""
    q.axis("temperature", temperatures.temperature_c, "Temperature", unit="°C", format=".0f")


def swing_axes(q: Quantities, swings: Sequence[Swing]) -> None:
    """Settings of the sensitivity analysis, named with their two values."""
    pairs = [f"{swing.low:.3g} or {swing.high:.3g}".replace("-", "\N{MINUS SIGN}") for swing in swings]
    names = [f"{swing.label}, {pair} {swing.unit}".strip() for swing, pair in zip(swings, pairs, strict=True)]
    q.axis("key", np.array([swing.key for swing in swings], dtype=object), "Key", names=names)
    q.axis("end", ["low", "high"], "End", names=["lower value", "upper value"])


# --- The run


def predict(config: CameraReportConfig, *, progress: Progress) -> dict[str, Any]:
    """The sensor without temperatures, changes and frames, for sweeps and comparisons."""
    del progress
    return predicted(predict_camera(config))


def predicted(prediction: CameraPrediction, *records: Any) -> dict[str, Any]:
    """Sections of a prediction; requirements are judged by its numbers and those of further ``records``."""
    guide_coverage = coverage(prediction)
    requirements = judge(limits(prediction.config), numbers_of(*prediction.records, guide_coverage, *records))
    return {
        "setup": summarise_sensor(prediction, requirements),
        "requirements": requirements,
        **dict(zip(("optics", "accuracy", "sky"), prediction.records, strict=True)),
        "fields": tabulate_fields(prediction),
        "magnitudes": sweep_magnitude(prediction),
        "attitudes": sample_attitudes(prediction),
        "coverage": guide_coverage,
    }


SECTIONS: Mapping[str, Section] = {
    "setup": Section(record=SensorSummary, figures={"lens": draw_lens_section, "spots": draw_spots_over_field}),
    "requirements": REQUIREMENTS,
    "optics": Section(
        record=Optics, vertical=True, caption="Lens and detector, as configured."
    ),
    "accuracy": Section(
        record=StarAccuracy,
        vertical=True,
        caption="The star of [star], one axis, one standard deviation, mean over the detector.",
    ),
    "sky": Section(record=SkyPerformance, vertical=True, caption="Detection, and the real sky (1σ)."),
    "fields": Section(
        record=FieldPerformance,
        axes=field_axes,
        caption="Over the field; spot and focus of all light of the pass band.",
    ),
    "magnitudes": Section(
        record=MagnitudeCurves,
        axes=magnitude_axes,
        caption="Against magnitude, mean over the detector, one axis, one standard deviation.",
        figures={
            "magnitude_accuracy": curves(
                "magnitude",
                lines="single_star_arcsec nea_arcsec nea_bound_arcsec",
                log="y",
                y="One axis, 1σ",
                aspect_ratio=0.9,
                width="half",
            ),
            "completeness": curves("magnitude", lines="detected_fraction", aspect_ratio=0.9, width="half"),
        },
    ),
    "attitudes": Section(record=AttitudeSamples, figures={"sky_distributions": draw_sky}),
    "temperatures": Section(
        record=Temperatures,
        axes=temperature_axis,
        table="thermal",
        caption="Over temperature, at fixed detector position.",
    ),
    "thermal": Section(record=ThermalRange),
    "changes": Section(
        record=Swing,
        dim="key",
        along="key",
        axes=swing_axes,
        table="what_to_change",
        across="end",
        columns="attitude_cross_change limiting_magnitude_change_mag",
        caption="Relative change of the attitude error across and change of the limiting magnitude, by key.",
        figures={"what_to_change": bars("key", bars="attitude_cross_change", by="end", aspect_ratio=0.5)},
    ),
    "coverage": COVERAGE,
    "lost_in_space": LOST_IN_SPACE,
    "motion": MOTION,
    "life": LIFE,
    "manufactured": MANUFACTURED,
    "rendered_lenses": RENDERED_LENSES,
    "frames": FRAMES,
    "solved": SOLVED,
}  # fmt: skip
