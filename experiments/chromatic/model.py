"""What the chromatic test should give: ACC18's statistics, predictions by ray trace alone, the decentre behind them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from experiments.laboratory.bench import Bench, point_field
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.frames import field_angles_deg
from optics.lens.perturb import decentre, tilt
from optics.lens.system import LensSystem
from optics.light.band import band_nodes
from optics.rays.paraxial import lateral_colour_mm
from optics.rays.pupil import PupilSamples, entrance_pupil, gauss_disk, sobol_disk
from optics.rays.spots import spot_moments
from render.tracing.tracer import Tracer

__all__ = [
    "CALIBRATIONS",
    "PUBLISHED_TABLE1_PX",
    "Solution",
    "after_calibration",
    "band_pairs",
    "bundle_prediction",
    "expected_spots",
    "paraxial_prediction",
    "perturbed",
    "rms",
    "shifts",
    "solve_perturbation",
    "table1",
]


PUBLISHED_TABLE1_PX = {"600-500": (-1e-4, 5e-3), "800-600": (0.12, 7e-3)}
"""ACC18 Table 1, (X, Y)."""

CALIBRATIONS = ("as found", "principal point", "focal length", "both")
COARSE = gauss_disk(5, 12)
PREDICTION_NODES = 11
"""Wavelength nodes of the predictions; another number than the renderer's on purpose."""


def band_pairs(centres_nm: Sequence[float], reference: int) -> list[tuple[str, int, int]]:
    """Name, minuend and subtrahend of each difference as ACC18 eq. 15 has them: the longer wavelength first."""
    pairs = []
    for band in range(len(centres_nm)):
        if band != reference:
            high, low = (band, reference) if centres_nm[band] > centres_nm[reference] else (reference, band)
            pairs.append((f"{centres_nm[high]:g}-{centres_nm[low]:g}", high, low))
    return pairs


def shifts(position_px: FloatArray, pairs: Sequence[tuple[str, int, int]]) -> dict[str, FloatArray]:
    """Shift (..., 2) of every point for each pair of bands, from positions (..., b, 2); ACC18 eq. 15."""
    return {name: position_px[..., high, :] - position_px[..., low, :] for name, high, low in pairs}


def table1(shift_px: FloatArray) -> FloatArray:
    """Signed mean over positions and points, halved (ACC18 eq. 16): (..., p, j, 2) -> (..., 2)."""
    return np.asarray(shift_px.mean((-3, -2)) / 2.0)


def rms(shift_px: FloatArray) -> FloatArray:
    """Root mean square per axis over positions and points, (p, j, 2) -> (2,)."""
    return np.asarray(np.sqrt((shift_px**2).mean((0, 1))))


def after_calibration(shift_px: FloatArray, from_centre_px: FloatArray) -> dict[str, FloatArray]:
    """Shifts that remain when a camera model has parameters of its own for the band.

    Parameters
    ----------
    shift_px : (p, j, 2)
        Shifts of the points.
    from_centre_px : (p, j, 2)
        Their places, from the principal point.

    Returns
    -------
    dict of str to (p, j, 2)
        ``as found``; without the mean (a principal point per band); without the scale (a focal length per band, least
        squares); without both, fitted together.
    """
    shift, place = shift_px.reshape(-1, 2), from_centre_px.reshape(-1, 2)
    one = np.zeros((len(shift), 2, 3))
    one[:, 0, 0] = one[:, 1, 1] = 1.0
    one[:, :, 2] = place
    design, data = one.reshape(-1, 3), shift.ravel()
    columns = {"as found": [], "principal point": [0, 1], "focal length": [2], "both": [0, 1, 2]}
    left = {}
    for name, use in columns.items():
        fit = design[:, use] @ np.linalg.lstsq(design[:, use], data, rcond=None)[0] if use else np.zeros_like(data)
        left[name] = (data - fit).reshape(shift_px.shape)
    return left


def _shares(bench: Bench, instrument: Instrument) -> tuple[FloatArray, FloatArray]:
    """Wavelength nodes (b, k) of the predictions and the share of the light each stands for."""
    nodes = band_nodes(bench.filters, PREDICTION_NODES)
    light = nodes.weight_nm * nodes.transmission * bench.lamp.photon_density(nodes.wavelength_nm)
    light = light * instrument.camera.response_at(nodes.wavelength_nm)
    return nodes.wavelength_nm, light / light.sum(1, keepdims=True)


def expected_spots(
    bench: Bench, instrument: Instrument, direction: FloatArray, samples: PupilSamples = COARSE
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (p, j, b, 2), RMS radius (p, j, b) [px] and transmitted area (p, j, b) [mm^2] of the ray bundles.

    Photon-weighted, by the NumPy trace alone: no renderer, image or noise takes part. NaN where no ray arrives.
    """
    camera = instrument.camera
    wavelength, share = _shares(bench, instrument)
    field_x, field_y = field_angles_deg(direction.reshape(-1, 3))
    spot = spot_moments(camera.focused_lens, field_x, field_y, wavelength.ravel(), samples=samples)
    x, y, second, area = (
        v.reshape(-1, *share.shape) for v in (spot.x_mm, spot.y_mm, spot.xx_mm2 + spot.yy_mm2, spot.transmitted_mm2)
    )
    light = share * area / np.maximum((share * area).sum(2, keepdims=True), 1e-300)
    mean_x, mean_y = ((v * light).sum(2) for v in (x, y))
    apart = (x - mean_x[..., None]) ** 2 + (y - mean_y[..., None]) ** 2
    radius = np.sqrt(((second + apart) * light).sum(2)) / camera.pixel_pitch_mm
    shape = (*direction.shape[:2], len(share))
    place = np.stack(camera.to_pixel(mean_x, mean_y), axis=-1).reshape(*shape, 2)
    return place, radius.reshape(shape), (area * share).sum(2).reshape(shape)


def bundle_prediction(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Photon-weighted bundle means (p, j, b, 2) [px] by the NumPy trace, without renderer, image or noise.

    A few rays are enough for a round clear pupil; where apertures cut the light, thousands of them find the cut.
    """
    place, _, area = expected_spots(bench, instrument, direction)
    if np.allclose(area, entrance_pupil(instrument.camera.focused_lens).area_mm2, rtol=1e-9):
        return place
    fine, points = sobol_disk(4096, seed=1), direction.reshape(-1, 3)
    parts = [expected_spots(bench, instrument, part[None], fine)[0][0] for part in np.array_split(points, len(points))]
    return np.concatenate(parts).reshape(place.shape)


def paraxial_prediction(bench: Bench, instrument: Instrument, direction: FloatArray) -> FloatArray:
    """Positions (p, j, b, 2) [px] relative to the reference band by paraxial lateral colour of the centred lens.

    The chief ray's height is averaged over the light of each band: over 100 nm it is far from linear in wavelength.
    """
    camera = instrument.camera
    wavelength, share = _shares(bench, instrument)
    tangent = direction.reshape(-1, 3)[:, :2] / direction.reshape(-1, 3)[:, 2:]
    # the paraxial chief ray is linear in the tangent of the field
    height_mm = lateral_colour_mm(camera.focused_lens, 1.0, wavelength) / np.tan(np.radians(1.0))
    per_tangent = (height_mm * share).sum(1)
    per_tangent = (per_tangent - per_tangent[bench.reference]) / camera.pixel_pitch_mm
    return (tangent[:, None, :] * per_tangent[:, None]).reshape(*direction.shape[:2], len(share), 2)


def perturbed(lens: LensSystem, element: str, kind: str, axis: int, amount: float) -> LensSystem:
    """The lens with one element moved: ``decentre`` [mm] along x or y, ``tilt`` [deg] in the plane of x or y and z."""
    if kind == "decentre":
        return decentre(lens, element, *((amount, 0.0) if axis == 0 else (0.0, amount)))
    return tilt(lens, element, *((0.0, amount) if axis == 0 else (amount, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """The movement of one element that gives the published mean shift.

    Attributes
    ----------
    element, kind : str
        Which, and how: ``decentre`` or ``tilt``.
    amount : float
        um for a decentre, arcmin for a tilt; NaN when none up to the limit does.
    table1_px : dict of str to (2,)
        ACC18's statistic at this amount, by ray trace.
    rms_px : dict of str to (2,)
        RMS shift per axis.
    boresight_px : (2,)
        Motion of the whole image in the reference band.
    """

    element: str
    kind: str
    amount: float
    table1_px: dict[str, FloatArray]
    rms_px: dict[str, FloatArray]
    boresight_px: FloatArray

    @property
    def unit(self) -> str:
        """Unit of `amount`."""
        return "um" if self.kind == "decentre" else "arcmin"

    def apply(self, lens: LensSystem, axis: int) -> LensSystem:
        """The lens with the element moved by this amount; see `perturbed`."""
        return perturbed(lens, self.element, self.kind, axis, self.amount / _UNIT[self.kind])


_LIMIT = {"decentre": 3.0, "tilt": 3.0}
_UNIT = {"decentre": 1e3, "tilt": 60.0}
"""um per mm, arcmin per deg: `Solution.amount` against the argument of `perturbed`."""


def solve_perturbation(
    bench: Bench,
    instrument: Instrument,
    direction: FloatArray,
    *,
    element: str,
    kind: str,
    pair: str,
    axis: int,
    wanted_px: float,
) -> Solution:
    """How far one element has to move for the statistic of one pair of bands to reach a value.

    Parameters
    ----------
    bench, instrument
        The laboratory with the centred lens.
    direction : (p, j, 3)
        Target points.
    element, kind : str
        What moves: ``decentre`` (up to 3 mm) or ``tilt`` about the element's own first vertex (up to 3 deg).
    pair, axis : str, int
        Which entry of Table 1. Amounts count in the lens frame: a decentre along +x (increasing column) or +y
        (decreasing row); a tilt as rotation vector along +y for axis x, along +x for axis y.
    wanted_px : float
        Its value.

    Raises
    ------
    ConvergenceError
        If the root is not found within the tolerance.
    """
    lens = instrument.camera.lens
    pairs = band_pairs([band.centre_nm for band in bench.filters], bench.reference)
    stars = point_field(bench, instrument, direction.reshape(-1, 3))

    def means(amount: float) -> FloatArray:
        camera = replace(instrument.camera, lens=perturbed(lens, element, kind, axis, amount))
        mean = Tracer(camera, general=True).bundle_means(stars, rings=4, arms=12)
        return mean.reshape(*direction.shape[:2], len(bench.filters), 2)

    def excess(amount: float) -> float:
        return float(table1(shifts(means(amount), pairs)[pair])[axis]) - wanted_px

    amount = _root(excess, _LIMIT[kind])
    found = means(amount if np.isfinite(amount) else 0.0)
    every = shifts(found, pairs)
    return Solution(
        element=element,
        kind=kind,
        amount=amount * _UNIT[kind],
        table1_px={name: table1(shift) for name, shift in every.items()},
        rms_px={name: rms(shift) for name, shift in every.items()},
        boresight_px=(found - means(0.0))[:, :, bench.reference].mean((0, 1)),
    )


def _root(excess: Callable[[float], float], limit: float) -> float:
    """Root nearest to zero within +-limit; NaN if there is none.

    The statistic is nearly linear in the movement, so its slope at zero tells where to look.
    """
    step = limit * 1e-2
    slope = (excess(step) - excess(-step)) / (2 * step)
    guess = -excess(0.0) / slope if slope != 0.0 else np.inf
    if not abs(guess) < 1.5 * limit:
        return float("nan")
    for margin in (0.3 * abs(guess) + 0.1 * step, limit):
        low, high = max(guess - margin, -limit), min(guess + margin, limit)
        if low < high and excess(low) * excess(high) <= 0:
            break
    else:
        return float("nan")
    root, state = brentq(excess, low, high, xtol=limit * 1e-6, full_output=True)
    if not state.converged:
        raise ConvergenceError(
            f"the movement that gives the wanted shift was not found within {state.iterations} steps"
        )
    return float(root)
