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
from render.field_response import FieldResponse

__all__ = ["SECTIONS", "predict", "predicted"]

CURVE_POINTS = 91


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


def setup(prediction: CameraPrediction, requirements: Sequence[Requirement]) -> SensorSummary:
    """Summary of the sensor."""
    lens, chip = prediction.state.sensor.camera.lens.name, prediction.detector.name
    return SensorSummary(
        name=prediction.config.name or f"{lens} on {chip}",
        lens=lens,
        detector=chip,
        answer=missed_words(requirements),
        requirements_missed=sum(not requirement.met for requirement in requirements),
        prediction=prediction,
    )


def draw_section(outcome: Outcome) -> Figure:
    """Section through the lens with fans of rays to the middle, to 70 % of the half diagonal and to the corner."""
    state: FieldResponse = outcome.result["setup"].prediction.state
    fields, measured = state.performance.field_deg, state.sensor.camera.lens.measured
    if measured is not None:
        figure, (light, width) = new_figure(1, 2, aspect_ratio=0.38)
        light.plot(fields, state.performance.vignetting, "o-")
        light.set(xlabel="Field [°]", ylabel="Light of a star, relative to the axis", ylim=(0.0, None))
        width.plot(fields, state.performance.white.rms_mm() * 1e3, "o-")
        width.set(xlabel="Field [°]", ylabel="RMS radius of the PSF [µm]", ylim=(0.0, None))
        return figure
    figure = draw_lens(state.sensor.camera.focused_lens, fields_deg=[0.0, float(fields[2]), float(fields[-1])])
    figure.axes[0].set_title("")
    width, height = figure.get_size_inches()
    figure.set_size_inches(7.6, 7.6 * height / width)
    return figure


def spots_over_field(outcome: Outcome) -> Figure:
    """Rays of the pass band at three fields, and a pixel of the detector."""
    state: FieldResponse = outcome.result["setup"].prediction.state
    camera, traced = state.sensor.camera, state.performance
    angles = [(float(angle), 0.0) for angle in traced.field_deg[[0, 2, 4]]]
    pixel_um = 1e3 * camera.pixel_pitch_mm
    return draw_spots(
        camera.focused_lens, fields_deg=angles, wavelength_nm=list(traced.wavelength_nm[[0, 2, 5]]), pixel_um=pixel_um
    )


# --- Over the field


@dataclass(frozen=True, slots=True, kw_only=True)
class Fields:
    """Over the field: spot, focus (both over the pass band), distortion, vignetting, colour."""

    spot_um: FloatArray = col("RMS spot radius", "um", ".2f", "field")
    focus_um: FloatArray = col("Best focus", "um", ".1f", "field")
    distortion_percent: FloatArray = col("Distortion", "percent", ".3f", "field")
    vignetting_percent: FloatArray = col("Vignetting", "percent", ".1f", "field")
    lateral_colour_px: FloatArray = col("Lateral colour", "px", ".3f", "field wavelength", shown=False)
    axial_focus_um: FloatArray = col("Best focus on axis", "um", ".1f", "wavelength", shown=False)
    performance: Any


def fields(prediction: CameraPrediction) -> Fields:
    """The traced performance of the lens."""
    lens = prediction.state.performance
    return Fields(
        spot_um=1e3 * lens.white.rms_mm(),
        focus_um=1e3 * lens.white.best_mm,
        distortion_percent=100.0 * lens.distortion,
        vignetting_percent=100.0 * (1.0 - lens.vignetting),
        lateral_colour_px=lens.lateral_colour_mm / prediction.state.sensor.camera.pixel_pitch_mm,
        axial_focus_um=1e3 * lens.axial_colour_mm,
        performance=lens,
    )


def field_axes(q: Quantities, fields: Fields) -> None:
    """Field angles and wavelengths of the trace."""
    q.axis("field", fields.performance.field_deg, "Field", unit="deg", format=".2f")
    q.axis("wavelength", fields.performance.wavelength_nm, "Wavelength", unit="nm", format=".0f")


# --- Against magnitude


@dataclass(frozen=True, slots=True, kw_only=True)
class Magnitudes:
    """Electrons, detection and accuracy of a star against magnitude, mean over the detector; NaN where it saturates."""

    electrons_e: FloatArray = col("Electrons", "e-", ".0f", "colour magnitude", shown=False)
    nea_arcsec: FloatArray = col("NEA", "arcsec", ".3f", "magnitude")
    nea_bound_arcsec: FloatArray = col("Cramér-Rao bound of the NEA", "arcsec", ".3f", "magnitude")
    single_star_arcsec: FloatArray = col("Single-star accuracy", "arcsec", ".3f", "magnitude")
    detected_fraction: FloatArray = col("Fraction of stars detected", "", ".3f", "magnitude")
    magnitude_mag: FloatArray
    colours_k: Sequence[float]


def magnitudes(prediction: CameraPrediction) -> Magnitudes:
    """Curves from above the saturation limit to one magnitude below the limiting magnitude."""
    state, stars, config = prediction.state, prediction.stars, prediction.config
    saturation, faintest = prediction.value("saturation_mag"), prediction.value("limiting_magnitude_mag") + 1.0
    magnitude = np.linspace(min(saturation - 0.5, faintest - 2.0), faintest, CURVE_POINTS)
    fraction = (np.arange(8) + 0.5) / 8.0 - 0.5
    camera = state.sensor.camera
    radius = np.hypot(*np.meshgrid(fraction * camera.width_px, fraction * camera.height_px)).ravel()
    electrons = [prediction.electrons(np.full(len(radius), m), config.star.temperature_k, radius) for m in magnitude]

    def curve(sigma_px: FloatArray) -> FloatArray:
        rms = [float(np.sqrt((stars.sigma_at(sigma_px, e, radius) ** 2).mean())) for e in electrons]
        return np.where(magnitude < saturation, np.nan, state.pixel_arcsec * np.array(rms))

    return Magnitudes(
        electrons_e=np.stack([prediction.electrons(magnitude, kelvin) for kelvin in config.star.colours_k]),
        nea_arcsec=curve(stars.centroid.noise_px),
        nea_bound_arcsec=curve(stars.centroid.bound_px),
        single_star_arcsec=np.hypot(curve(stars.centroid.total_px), np.nan_to_num(prediction.value("colour_arcsec"))),
        detected_fraction=np.array([float(stars.detected_at(e, radius).mean()) for e in electrons]),
        magnitude_mag=magnitude,
        colours_k=config.star.colours_k,
    )


def magnitude_axes(q: Quantities, magnitudes: Magnitudes) -> None:
    """Magnitudes and colours of the curves."""
    q.axis("magnitude", magnitudes.magnitude_mag, "Magnitude", unit="mag", format=".2f")
    q.axis("colour", np.array(magnitudes.colours_k), "Star", unit="K", format=".0f")


# --- Over the sky


@dataclass(frozen=True, slots=True, kw_only=True)
class Attitudes:
    """Prediction at the sampled attitudes."""

    samples: int = col("Attitudes")
    stars: FloatArray = col("Stars per frame", dims="attitude")
    cross_arcsec: FloatArray = col("Attitude across, 1σ", "arcsec", dims="attitude")
    roll_arcsec: FloatArray = col("Attitude roll, 1σ", "arcsec", dims="attitude")


def attitudes(prediction: CameraPrediction) -> Attitudes:
    """Stars and errors of every attitude; errors are infinite where too few stars are detected."""
    forecast = prediction.attitude
    return Attitudes(
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
    """Keys, named with their two values."""
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
        "setup": setup(prediction, requirements),
        "requirements": requirements,
        **dict(zip(("optics", "accuracy", "sky"), prediction.records, strict=True)),
        "fields": fields(prediction),
        "magnitudes": magnitudes(prediction),
        "attitudes": attitudes(prediction),
        "coverage": guide_coverage,
    }


SECTIONS: Mapping[str, Section] = {
    "setup": Section(record=SensorSummary, figures={"lens": draw_section, "spots": spots_over_field}),
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
        record=Fields,
        axes=field_axes,
        caption="Over the field; spot and focus of all light of the pass band.",
    ),
    "magnitudes": Section(
        record=Magnitudes,
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
    "attitudes": Section(record=Attitudes, figures={"sky_distributions": draw_sky}),
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
