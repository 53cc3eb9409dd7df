"""The numbers of the camera report, each described once."""

from __future__ import annotations

import numpy as np

from experiments.camera.result import Result
from experiments.harness.quantities import Quantities

__all__ = ["describe"]


CURVE_POINTS = 91


def describe(result: Result) -> Quantities:
    """Quantities of a run."""
    q = Quantities()
    for name, one in result.scalars.items():
        q.add(name, one.value, one.label, unit=one.unit, format=one.format)
    _fields(q, result)
    _magnitudes(q, result)
    _sky(q, result)
    _thermal(q, result)
    _requirements(q, result)
    _swings(q, result)
    _compared(q, result)
    return q


def _fields(q: Quantities, result: Result) -> None:
    state, lens = result.prediction.state, result.prediction.state.performance
    pitch = state.instrument.camera.pixel_pitch_mm
    q.axis("field", lens.field_deg, "Field angle", unit="deg", format=".2f", key="field_deg")
    q.axis("wavelength", lens.wavelength_nm, "Wavelength", unit="nm", format=".0f", key="wavelength_nm")
    for name, values, label, unit, form in (
        ("field_spot_um", 1e3 * lens.white.rms_mm(), "RMS spot radius", "um", ".2f"),
        ("field_focus_um", 1e3 * lens.white.best_mm, "Best focus", "um", ".1f"),
        ("field_distortion_percent", 100.0 * lens.distortion, "Distortion", "percent", ".3f"),
        ("field_vignetting_percent", 100.0 * (1.0 - lens.vignetting), "Vignetting", "percent", ".1f"),
    ):
        q.add(name, values, label, unit=unit, dims="field", format=form)
    q.add(
        "field_colour_px",
        lens.lateral_colour_mm / pitch,
        "Lateral colour",
        unit="px",
        dims="field wavelength",
        format=".3f",
    )
    q.add(
        "axial_colour_focus_um",
        1e3 * lens.axial_colour_mm,
        "Best focus on axis",
        unit="um",
        dims="wavelength",
        format=".1f",
    )


def _magnitudes(q: Quantities, result: Result) -> None:
    prediction, config = result.prediction, result.config
    state, stars = prediction.state, prediction.stars
    low, high = prediction.value("saturation_mag") - 0.5, prediction.value("limiting_magnitude_mag") + 1.0
    magnitude = np.linspace(min(low, high - 2.0), high, CURVE_POINTS)
    q.axis("magnitude", magnitude, "Magnitude", unit="mag", format=".2f", key="magnitude_mag")
    q.axis("colour", np.array(config.star.colours_k), "Star", unit="K", format=".0f", key="temperature_k")
    electrons = np.stack([prediction.electrons(magnitude, t) for t in config.star.colours_k])
    q.add("star_electrons_e", electrons, "Electrons", unit="e-", dims="colour magnitude", format=".0f")
    part = (np.arange(8) + 0.5) / 8.0 - 0.5
    camera = state.instrument.camera
    radius = np.hypot(*np.meshgrid(part * camera.width_px, part * camera.height_px)).ravel()
    curves = {"nea": stars.centroid.noise_px, "bound": stars.centroid.bound_px, "single": stars.centroid.total_px}
    found: list[float] = []
    values: dict[str, list[float]] = {name: [] for name in curves}
    for m in magnitude:
        e = prediction.electrons(np.full(len(radius), m), config.star.temperature_k, radius)
        found.append(float(stars.found_at(e, radius).mean()))
        for name, curve in curves.items():
            values[name].append(state.pixel_arcsec * float(np.sqrt((stars.sigma_at(curve, e, radius) ** 2).mean())))
    saturated = magnitude < prediction.value("saturation_mag")
    colour = np.nan_to_num(prediction.value("colour_arcsec"))
    values["single"] = np.hypot(values["single"], colour).tolist()
    for name, label in (("nea", "NEA"), ("bound", "Bound of the NEA"), ("single", "Single-star accuracy")):
        shown = np.where(saturated, np.nan, values[name])
        q.add(f"magnitude_{name}_arcsec", shown, label, unit="arcsec", dims="magnitude", format=".3f")
    q.add("magnitude_found", np.array(found), "Share of stars that are found", dims="magnitude", format=".3f")


def _sky(q: Quantities, result: Result) -> None:
    forecast = result.prediction.attitude
    cross = np.sqrt((forecast.total_arcsec[:, :2] ** 2).mean(axis=1))
    for name, values, label, unit in (
        ("sky_stars", forecast.stars, "Stars per frame", ""),
        ("sky_cross_arcsec", cross, "Attitude across", "arcsec"),
        ("sky_roll_arcsec", forecast.total_arcsec[:, 2], "Attitude roll", "arcsec"),
    ):
        q.add(name, values, label, unit=unit, dims="attitude", json="")
    q.add("attitudes", len(forecast.stars), "Attitudes")


def _thermal(q: Quantities, result: Result) -> None:
    study = result.thermal
    q.axis("temperature", study.temperature_c, "Temperature", unit="°C", format=".0f", key="temperature_c")
    for name, values, label, unit, form in (
        ("thermal_focus_um", study.focus_um, "Best focus", "um", ".1f"),
        ("thermal_scale_ppm", study.scale_ppm, "Plate scale, change", "ppm", ".1f"),
        ("thermal_spot_px", study.spot_px, "RMS spot radius, largest", "px", ".3f"),
        ("thermal_colour_px", study.colour_px, "Lateral colour", "px", ".3f"),
        ("thermal_nea_arcsec", study.nea_arcsec, "NEA", "arcsec", ".3f"),
        ("thermal_attitude_arcsec", study.attitude_arcsec, "Attitude across, median", "arcsec", ".3f"),
    ):
        q.add(name, values, label, unit=unit, dims="temperature", format=form)


def _requirements(q: Quantities, result: Result) -> None:
    verdicts = result.verdicts
    q.axis("requirement", np.array([one.key for one in verdicts], dtype=object), "Requirement")
    q.add("required", np.array([one.required for one in verdicts]), "Required", dims="requirement")
    q.add("predicted", np.array([one.predicted for one in verdicts]), "Predicted", dims="requirement")
    q.add("met", np.array([one.met for one in verdicts], dtype=bool), "Met", dims="requirement")
    q.add("requirements_missed", sum(not one.met for one in verdicts), "Requirements that are missed")


def _swings(q: Quantities, result: Result) -> None:
    from experiments.camera.tornado import JUDGED

    nothing = dict.fromkeys(JUDGED, float("nan"))
    q.axis("key", np.array([swing.key for swing in result.swings], dtype=object), "Key")
    q.axis("end", ["low", "high"], "End")
    for name in JUDGED:
        values = [[(end or nothing)[name] for end in (s.at_low, s.at_high)] for s in result.swings]
        q.add(f"swing_{name}", np.array(values).reshape(-1, 2), f"Change of {name}", dims="key end", format=".3f")


def _compared(q: Quantities, result: Result) -> None:
    if result.rendered is None:
        return
    q.axis("comparison", np.array([one.name for one in result.compared], dtype=object), "Quantity")
    for name, label in (("measured", "Measured in frames"), ("predicted", "Predicted"), ("error", "Uncertainty")):
        values = np.array([getattr(one, name) for one in result.compared])
        q.add(f"compared_{name}", values, label, dims="comparison", json=f"frames[comparison].{name}")
