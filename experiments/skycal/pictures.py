"""The frame of a camera with its stars marked."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from calib.flags import StarFlag, has_flag
from experiments.harness.plotting import new_figure
from experiments.skycal.calibrate import CalibratedCamera
from optics.arrays import FloatArray
from optics.figures import draw_image

STAR_COLOURS = (
    (3000.0, "#ff9d5c"),
    (4300.0, "#ffc48f"),
    (5300.0, "#ffe9cf"),
    (7000.0, "#f4f3ff"),
    (12000.0, "#a9c4ff"),
)
"""Colours of black bodies on a screen, a little more saturated than they are."""
LEFT_OUT = "#ff5d8f"


def sky_frame(made: CalibratedCamera) -> Figure:
    """One frame with the stars that were matched and used; columns less their medians, stars enlarged."""
    recording, matched = made.recording, made.matched
    dn, number = recording.example.dn, recording.example_index
    height, width = dn.shape
    half = height > 0.75 * width
    figure, axis = new_figure(width="half" if half else "full", aspect_ratio=0.1 + 0.9 * height / width)
    light = gaussian_filter(dn.astype(np.float32) - np.median(dn, axis=0).astype(np.float32), 0.8)
    size = {"widest_px": 600, "grow": 3} if half else {"widest_px": 1200, "grow": 5}
    draw_image(light, axis, percentiles=(99.0 if half else 98.0, 99.98), **size)
    mine, frame = (matched.frame == number) & made.used, recording.frames[number]
    colour = star_colour(made.scene.sky.temperature_k[matched.star[mine]])
    axis.scatter(*matched.pixel_px[mine].T, s=28 if half else 52, facecolors="none", edgecolors=colour, linewidths=0.9)
    rest = np.ones(len(frame.found), bool)
    rest[matched.row[mine] - frame.first_row] = False
    x, y = frame.found.x_px[rest], frame.found.y_px[rest]
    saturated = has_flag(frame.found.flags[rest], StarFlag.SATURATED)
    axis.scatter(x[~saturated], y[~saturated], s=14 if half else 26, marker="x", color=LEFT_OUT, linewidths=0.7)
    axis.scatter(x[saturated], y[saturated], s=60, marker="s", facecolors="none", edgecolors=LEFT_OUT, linewidths=0.9)
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axis.set(xlabel="column [px]", ylabel="row [px]")
    axis.grid(visible=False)
    return figure


def star_colour(temperature_k: FloatArray) -> FloatArray:
    """RGB (n, 3) of stars."""
    knots = np.log([t for t, _ in STAR_COLOURS])
    rgb = np.array([[int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)] for _, name in STAR_COLOURS])
    return np.stack([np.interp(np.log(temperature_k), knots, channel) for channel in rgb.T], axis=1)
