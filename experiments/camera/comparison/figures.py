"""Figures of the comparison."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.camera.comparison.study import SideBySide
from experiments.camera.records import detector_radii
from experiments.harness.plotting import MARKERS, PALETTE, log_ticks, new_figure
from experiments.harness.quantities import Outcome

__all__ = ["bars", "stars", "the_sky"]


BARS = {
    "limiting_magnitude_mag": "limiting magnitude [mag]",
    "nea_arcsec": "NEA, 1σ [″]",
    "single_star_arcsec": "single star, 1σ [″]",
    "attitude_cross_arcsec": "attitude across, 1σ [″]",
    "attitude_roll_arcsec": "attitude roll, 1σ [″]",
    "stars_worst_per_frame": "stars, worst 1 % of the sky",
}
POINTS = 41


def bars(outcome: Outcome) -> Figure:
    """Main quantities, one bar per sensor."""
    result: SideBySide = outcome.result
    figure, axes = new_figure(2, 3, aspect_ratio=0.3 + 0.06 * len(result.sensors), sharey=True)
    place = np.arange(len(result.sensors))
    colours = [PALETTE[n % len(PALETTE)] for n in place]
    for panel, (name, words) in zip(axes.ravel(), BARS.items(), strict=True):
        panel.barh(place, np.nan_to_num(outcome.values(name)), height=0.6, color=colours)
        panel.set(xlabel=words)
        panel.set_yticks(place, result.names)
        panel.grid(visible=False, axis="y")
    axes[0, 0].invert_yaxis()
    return figure


def stars(outcome: Outcome) -> Figure:
    """Share of stars that are found, and the NEA, against magnitude."""
    result: SideBySide = outcome.result
    figure, axes = new_figure(1, 2, aspect_ratio=0.42)
    for n, sensor in enumerate(result.sensors):
        prediction, colour = sensor.prediction, PALETTE[n % len(PALETTE)]
        state, errors, kelvin = prediction.state, prediction.stars, prediction.config.star.temperature_k
        full, limit = prediction.value("saturation_mag"), prediction.value("limiting_magnitude_mag")
        radius = detector_radii(state)
        found, noise = [], []
        magnitude = np.linspace(min(full, limit - 2.0), limit + 1.0, POINTS)
        for m in magnitude:
            light = prediction.electrons(np.full(len(radius), m), kelvin, radius)
            found.append(100.0 * float(errors.found_at(light, radius).mean()))
            sigma = errors.sigma_at(errors.centroid.noise_px, light, radius)
            noise.append(state.pixel_arcsec * float(np.sqrt((sigma**2).mean())))
        near = magnitude > limit - 2.0
        axes[0].plot(magnitude[near], np.array(found)[near], color=colour, label=sensor.name)
        seen = magnitude <= limit
        axes[1].plot(magnitude[seen], np.array(noise)[seen], color=colour, label=sensor.name)
    axes[0].set(xlabel="magnitude [mag]", ylabel="stars found [%]", ylim=(-3, 105))
    axes[1].set(xlabel="magnitude [mag]", ylabel="NEA, one axis, 1σ [″]", yscale="log")
    log_ticks(axes[1], "y")
    axes[1].legend()
    return figure


def the_sky(outcome: Outcome) -> Figure:
    """Share of the sky on which stars per frame, attitude across and roll are at most so much."""
    result: SideBySide = outcome.result
    figure, axes = new_figure(1, 3, aspect_ratio=0.36, sharey=True)
    for n, sensor in enumerate(result.sensors):
        forecast = sensor.prediction.attitude
        across = np.sqrt((forecast.total_arcsec[:, :2] ** 2).mean(axis=1))
        for panel, values in zip(axes, (forecast.stars, across, forecast.total_arcsec[:, 2]), strict=True):
            known = np.sort(values[np.isfinite(values)])
            share = 100.0 * (np.arange(len(known)) + 1) / len(values)
            panel.plot(known, share, color=PALETTE[n % len(PALETTE)], label=sensor.name, marker=MARKERS[n],
                       markevery=max(len(known) // 6, 1), markersize=3)  # fmt: skip
    for panel, words in zip(axes, ("stars per frame", "attitude across, 1σ [″]", "roll, 1σ [″]"), strict=True):
        panel.set(xlabel=words)
    for panel in axes[1:]:
        panel.set_xscale("log")
        log_ticks(panel, "x")
    axes[0].set_ylabel("share of the sky [%]")
    axes[0].legend()
    return figure
