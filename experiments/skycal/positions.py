"""Positions of the matched stars, one more error in each kind, and without the shift by the colour of the star."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.flags import StarFlag, has_flag
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.skycal.match import Matched
from experiments.skycal.measure import Recording
from experiments.skycal.psf_bank import BankRenderer
from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from experiments.skycal.truth import trace_colour
from optics.arrays import FloatArray

__all__ = ["STEPS", "colour_classes", "positions"]


STEPS = ("reference", "light", "own", "measured")
"""Kinds of positions, one more error in each: where light of the reference colour would fall, where the star's light
fell, the centroid with the PSF of the star's own colour, the centroid with the PSF of one colour."""
COLOURS = 5
"""Classes of temperature for which PSFs are rendered when every star gets one of its own colour."""


def positions(scene: Scene, recording: Recording, matched: Matched, config: Config) -> dict[str, FloatArray]:
    """Positions (n, 2) [px] of the matched stars by kind, `STEPS` and "corrected"; NaN where one is not known."""
    reference = np.full((len(matched), 2), np.nan)
    there = np.isfinite(matched.in_cam).all(axis=1)
    if there.any():
        reference[there] = trace_colour(scene, matched.in_cam[there], config.sky.reference_k)
    own = _own_colour_centroids(scene, recording, matched, config)
    light = matched.photon_px
    corrected = own - (light - reference)
    return {"reference": reference, "light": light, "own": own, "measured": matched.pixel_px, "corrected": corrected}


def colour_classes(temperature_k: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Temperatures [K] of `COLOURS` classes of equal numbers of stars, and the class of every star (n,)."""
    edges = np.quantile(temperature_k, np.linspace(0.0, 1.0, COLOURS + 1)[1:-1])
    member = np.searchsorted(edges, temperature_k, side="right")
    present, member = np.unique(member, return_inverse=True)
    # photons shift in proportion to 1/T rather than to T
    typical = [1.0 / np.mean(1.0 / temperature_k[member == k]) for k in range(len(present))]
    return np.array(typical), member


def _own_colour_centroids(scene: Scene, recording: Recording, matched: Matched, config: Config) -> FloatArray:
    """Centroids (n, 2) [px] with PSFs of the stars' own colours, which the catalogue tells once they have names.

    The origin of a PSF is the mean of the rays of its own colour, so that these positions estimate where the star's own
    light fell. NaN where the fit does not converge.
    """
    renderer = BankRenderer(scene, config)
    centroider = config.centroid if needs_epsf(config.centroid) else "epsf"
    colour, member = colour_classes(scene.sky.temperature_k[matched.star])
    position = np.full((len(matched), 2), np.nan)
    for number, temperature in enumerate(colour):
        bank = renderer.render(float(temperature))
        mine = np.flatnonzero(member == number)
        stamps = recording.stamps.select(matched.row[mine])
        table = bank.measure(replace(stamps, start_px=matched.pixel_px[mine]), recording.noise, centroider)
        bad = has_flag(table.flags, StarFlag.NOT_CONVERGED | StarFlag.NO_DATA)
        position[mine] = np.where(bad[:, None], np.nan, np.column_stack([table.x_px, table.y_px]))
    return position
