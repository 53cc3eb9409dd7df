"""Star positions: by ray trace, by the mean of all light, by centroids with the PSF of the star's colour or of one.

Positions of the matched stars come in kinds, each with one more error: ``reference``, position of light of the
reference colour; ``light``, position of the star's light; ``star_psf``, centroid with the PSF of the star's colour;
``measured``, centroid with the PSF of one colour. ``corrected`` is ``star_psf`` minus the colour shift of the star.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.flags import has_flag
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.skycal.match import FAILED, Matched
from experiments.skycal.measure import BankRenderer, Recording
from experiments.skycal.scene import CameraScene
from experiments.skycal.settings import SkycalConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze_all
from render.psf_lattice import ray_means_px

STEPS = ("reference", "light", "star_psf", "measured")
"""Kinds of positions, one more error in each."""
COLOURS = 5
"""Classes of temperature for which PSFs are rendered."""
EDGE_FRACTION = 0.012
"""Margin of the chart over the longer side of the detector, so that its traced points stay on the detector."""
CHART_LOG2_RAYS = 3
"""The chart has eight times the rays of a star: errors of some 1e-3 px average out over stars, but not in the chart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """The truth: traced positions of light of the reference colour."""

    direction: FloatArray  # (n, 3) Unit vectors in cam
    pixel_px: FloatArray  # (n, 2) Mean of the rays
    rows: int  # Rows of the grid, which is stored row by row: n = rows x columns
    columns: int

    def __post_init__(self) -> None:
        freeze_all(self, direction=("n", 3), pixel_px=("n", 2))


def trace_colour(
    scene: CameraScene, direction: FloatArray, temperature_k: float, *, more_log2_rays: int = 0
) -> FloatArray:
    """Mean landing point (n, 2) [px] of the rays of stars of one colour."""
    stars = scene.of_one_colour(direction, temperature_k)
    rays = scene.config.sobol_log2_rays + more_log2_rays
    return ray_means_px(scene.instrument.camera, stars, sobol_log2_rays=rays)


def trace_chart(scene: CameraScene, config: SkycalConfig) -> Chart:
    """Trace the truth on a regular grid of nominal pixels."""
    camera = scene.instrument.camera
    longer = max(camera.width_px, camera.height_px)
    columns, rows = (max(3, round(config.map_points * n / longer)) for n in (camera.width_px, camera.height_px))
    edge = EDGE_FRACTION * longer
    x, y = np.meshgrid(
        np.linspace(edge, camera.width_px - 1 - edge, columns), np.linspace(edge, camera.height_px - 1 - edge, rows)
    )
    direction = scene.instrument.direction_at(x.ravel(), y.ravel())
    pixel = trace_colour(scene, direction, config.sky.reference_k, more_log2_rays=CHART_LOG2_RAYS)
    unlit = int((~np.isfinite(pixel).all(axis=1)).sum())
    if unlit:
        raise DomainError(
            f"{scene.name}: no light reaches {unlit} of {len(pixel)} points of the detector through lens "
            f"{camera.lens.name!r}; set {scene.name}.instrument.width_px and height_px smaller"
        )
    return Chart(direction=direction, pixel_px=pixel, rows=rows, columns=columns)


def star_positions(
    scene: CameraScene, recording: Recording, matched: Matched, config: SkycalConfig
) -> dict[str, FloatArray]:
    """Positions (n, 2) [px] of the matched stars by kind, `STEPS` and "corrected".

    NaN for a star that was not rendered, and where the fit does not converge.
    """
    reference = np.full((len(matched), 2), np.nan)
    rendered = np.isfinite(matched.in_cam).all(axis=1)
    if rendered.any():
        reference[rendered] = trace_colour(scene, matched.in_cam[rendered], config.sky.reference_k)
    star_psf = _star_psf_centroids(scene, recording, matched, config)
    light = matched.photon_px
    return {
        "reference": reference,
        "light": light,
        "star_psf": star_psf,
        "measured": matched.pixel_px,
        "corrected": star_psf - (light - reference),
    }


def colour_classes(temperature_k: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Temperatures [K] of `COLOURS` classes of equal numbers of stars, and the class of every star (n,)."""
    edges = np.quantile(temperature_k, np.linspace(0.0, 1.0, COLOURS + 1)[1:-1])
    member = np.searchsorted(edges, temperature_k, side="right")
    present, member = np.unique(member, return_inverse=True)
    # the spectrum, and with it the chromatic shift, varies as 1/T rather than as T
    typical = [1.0 / np.mean(1.0 / temperature_k[member == k]) for k in range(len(present))]
    return np.array(typical), member


def _star_psf_centroids(scene: CameraScene, recording: Recording, matched: Matched, config: SkycalConfig) -> FloatArray:
    """Centroids (n, 2) [px] with PSFs of the stars' colours: estimates of the position of all light of a star.

    The origin of each PSF is the mean of the rays of its colour.
    """
    renderer = BankRenderer(scene, config)
    centroider = config.centroid if needs_epsf(config.centroid) else "epsf"
    colour, member = colour_classes(scene.sky.temperature_k[matched.star])
    position = np.full((len(matched), 2), np.nan)
    for number, temperature in enumerate(colour):
        bank = renderer.render(float(temperature))
        stars = np.flatnonzero(member == number)
        stamps = recording.stamps.select(matched.row[stars])
        table = bank.measure(replace(stamps, start_px=matched.pixel_px[stars]), recording.noise, centroider)
        failed = has_flag(table.flags, FAILED)
        position[stars] = np.where(failed[:, None], np.nan, np.column_stack([table.x_px, table.y_px]))
    return position
