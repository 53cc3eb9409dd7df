"""What the numbers of all own frames have in common, each described once."""

from __future__ import annotations

import numpy as np

from experiments.harness.quantities import Quantities
from experiments.laboratory.own_frames.experiment import FramesResult
from experiments.laboratory.point_quantities import point_quantities

__all__ = ["describe"]


def describe(result: FramesResult) -> Quantities:
    """Quantities of a folder: those of the experiment, of its series, and what the frames say about themselves."""
    q, reduced, folder, checks = point_quantities(result.methods), result.reduced, result.folder, result.checks
    series = reduced.series
    q.axis("series", np.arange(len(series)) + 1, result.test.series, names=[one.name for one in series])
    q.add("source", "frames", "Source")
    result.test.describe(q, reduced, result.methods)
    every, signal = {"dims": "series"}, [one.signal_e for one in series]
    q.add("series_name", [one.name for one in series], "Name", **every, json="series[series].name")
    q.add("frames", [one.frames for one in series], "Frames", **every, json="series[series].frames")
    q.add("signal_e", signal, "Signal", unit="e-", **every, format=".0f", json="series[series].signal_e")
    usable = [one.usable_fraction for one in series]
    q.add("usable_fraction", usable, "Usable", **every, format=".3f", json="series[series].usable_fraction")
    q.add("points", len(folder.series[0].found_px), "Points")
    q.add("dark_frames", folder.dark_frames, "Frames with the lamp off")
    if folder.flat is None:
        percent = np.array([one.percent_px for one in series])
        noise = [np.sqrt((one.predicted_px(result.methods[0]) ** 2).mean() / one.frames) for one in series]
        place = "without_flat.one_percent_moves_px"
        q.add("percent_px", float(percent.max()), "Moved by 1 % of response", unit="px", format=".4f", json=place)
        place = "without_flat.over_noise_of_mean"
        q.add(
            "percent_over_noise", float((percent / noise).max()), "Over the noise of a mean", format=".2f", json=place
        )
    q.add("flat_frames", 0 if folder.flat is None else folder.flat.frames, "Flats")
    q.add("bad_pixels", folder.bad_pixels, "Pixels of the bad-pixel map")
    q.add("frame_size_px", [folder.width_px, folder.height_px], "Size of a frame", unit="px", dims="side")
    q.add("pixel_arcsec", folder.settings.pixel_arcsec, "Angle of a pixel", unit="arcsec")
    q.add("stated_gain", folder.settings.gain_dn_per_e, "Gain, stated", unit="DN/e-", json="gain_dn_per_e.stated")
    if checks.gain_dn_per_e is not None:
        place = "gain_dn_per_e.photon_transfer"
        q.add("transfer_gain", checks.gain_dn_per_e, "Gain, photon transfer", unit="DN/e-", json=place)
    if checks.noise_ratio is not None:
        q.add("noise_ratio", checks.noise_ratio, "Scatter over noise model")
    if checks.motion is not None:
        q.add("common_motion_px", checks.motion.rms_px, "Common motion", unit="px", format=".4f")
        q.add("drift_px", checks.motion.drift_px, "Drift", unit="px", format=".4f")
    return q
