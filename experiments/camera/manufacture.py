"""Manufactured lenses: drawn within the tolerances, refocused, and traced.

Spots, light and distortion of every lens follow by rays. Its noise-equivalent angle is the nominal sensor's times the
ratio of two predictions, of this lens and of the nominal one, from spots by rays blurred by diffraction as a Gaussian
(up to 12 % off for fast lenses, as rendered frames show); the attitude follows from this noise for the stars that the
nominal sensor detects.

Before calibration, the distortion is the error of the design's map after a common shift, roll and, with the focus,
scale; after calibration, the residual of a cubic polynomial added to that map for each lens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from calib.measure.centroid_prediction import predict_centroids
from experiments.camera.settings import Config
from experiments.harness.drawings import bars
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.frames import field_angles_deg
from optics.lens.perturb import change_index, change_shape, decentre, despace, tilt
from optics.lens.system import AMBIENT, LensSystem
from optics.rays.spots import trace_spots
from optics.units import UM_MM
from render.engine.random import Streams
from render.field_response import AIRY_SIGMA
from render.sensor_file.file import ManufactureConfig
from render.tracing.psf import ray_epsf

GRID = (7, 5)
"""Places of the detector, columns x rows, to `REACH` of its half sides."""
REACH = 0.95
ORDER = (6, 16)
NEA_PLACES = (8, 12, 22, 26)
"""One in every quarter, near the Gauss points: the mean over the detector."""
PERCENT = (50, 90, 95, 99)
SHOWN = {
    "nea": "NEA",
    "attitude_cross": "Attitude across, median",
    "lsfe_before": "Distortion, not calibrated",
    "lsfe_after": "Distortion, calibrated",
}
JUDGED = ("nea_arcsec", "attitude_cross_arcsec", "spot_px", "lsfe_before_arcsec", "lsfe_after_arcsec")
"""Requirements that a lens may miss."""
CHOSEN = (0.1, 0.5, 0.9)
"""Rendered lenses, as fractions of all in the order of their NEA."""
MOST = 8
"""Offenders that are listed."""
Move = Callable[[LensSystem, float], LensSystem]


@dataclass(frozen=True, slots=True, kw_only=True)
class Manufactured:
    """Manufactured lenses, one standard deviation, and the same by the sensitivities of all tolerances."""

    built_lenses: int = col("Lenses that were traced")
    built_lost: int = col("Lenses without an image")
    built_yield: float = col(
        "Fraction of lenses that meets the nea, attitude_cross, spot and lsfe requirements", "", ".3f"
    )
    built_arcsec: FloatArray = col("Not exceeded by this fraction of lenses", "arcsec", ".3f", "built percentile")
    built_nominal_arcsec: FloatArray = col("Nominal", "arcsec", ".3f", "built")
    built_spot_px: FloatArray = col(
        "Largest spot radius, not exceeded by this fraction of lenses", "px", ".3f", "percentile", shown=False
    )
    built_rms_arcsec: float = col("Distortion not calibrated, RMS of the lenses", "arcsec", ".3f")
    built_linear_arcsec: float = col("Distortion not calibrated, by sensitivities", "arcsec", ".3f")
    offender_lsfe_arcsec: FloatArray = col("Distortion not calibrated per 1σ", "arcsec", ".3f", "offender")
    offender_spot_um2: FloatArray = col("Growth of the squared spot radius per 1σ", "um²", ".3f", "offender")
    offenders: tuple[str, ...]
    chosen: tuple[tuple[LensSystem, float], ...]  # Lenses in their focus, and their NEA over that of the nominal one


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedLens:
    """A drawn lens in rendered frames."""

    share_percent: float = col("Lenses with less noise", "percent", ".0f")
    measured_arcsec: Measured = col("NEA in frames", "arcsec", ".3f")
    predicted_arcsec: float = col("predicted", "arcsec", ".3f")


@dataclass(frozen=True, slots=True)
class _Traced:
    """Properties of one traced lens."""

    map_px: FloatArray  # (g, 2)
    square_um2: FloatArray  # (g,) Squared RMS radius
    nea: float  # In the unit of the prediction's pixels
    off_mm: float  # Place of the detector, from where the design has it


class _Probe:
    """Traces lenses at the same places; compares with the nominal one."""

    def __init__(self, prediction: CameraPrediction) -> None:
        state, camera = prediction.state, prediction.state.sensor.camera
        self.prediction, self.pitch_mm = prediction, camera.pixel_pitch_mm
        x, y = (np.linspace(-REACH, REACH, n) for n in GRID)
        place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) * [camera.width_px / 2, camera.height_px / 2]
        self.place_px = place
        self.field_deg = field_angles_deg(state.sensor.direction_at(*(place + camera.centre_px).T))
        self.wave, self.share = state.light.wavelength_nm[0], state.fraction
        airy = AIRY_SIGMA * float(self.share @ self.wave) * 1e-6 * state.performance.f_number / self.pitch_mm
        airy *= camera.diffraction != "rays"
        self.blur_px = float(np.hypot(camera.blur_px, airy))
        self.electrons = prediction.value("electrons_e")
        self.area: float | None = None

    def rigid(self, scale: bool) -> FloatArray:
        """Shift, roll and, where the focus was set again, scale, on (2 g,) displacements: (2 g, 3 or 4)."""
        x, y = self.place_px.T
        zero, one = np.zeros_like(x), np.ones_like(x)
        columns = [(one, zero), (zero, one), (-y, x), (x, y)][: 4 if scale else 3]
        return np.stack([np.stack(pair, axis=-1).ravel() for pair in columns], axis=1)

    def trace(self, lens: LensSystem, *, refocused: bool, off_mm: float = 0.0) -> _Traced:
        """One lens, at the focus of the least mean square spot if that is set again, and off it."""
        x_deg, y_deg = self.field_deg
        spots = trace_spots(lens, x_deg, y_deg, self.wave, order=ORDER)
        weight = spots.area_mm2 * self.share[:, None]
        light = weight.sum((1, 2))
        if not (light > 0.0).all():
            raise ConvergenceError("no light reaches a point of the detector")
        weight = weight / light[:, None, None]
        rays, lit = spots.rays, weight > 0.0
        slope = [np.where(lit, one / np.where(lit, rays.dz, 1.0), 0.0) for one in (rays.dx, rays.dy)]
        at = [np.where(lit, one, 0.0) for one in (rays.x, rays.y)]
        off = [[v - (weight * v).sum((1, 2))[:, None, None] for v in pair] for pair in zip(at, slope, strict=True)]
        if refocused:
            cross = sum(float((weight * a * s).sum()) for a, s in off)
            off_mm -= cross / sum(float((weight * s * s).sum()) for _, s in off)
        at = [a + off_mm * s for a, s in zip(at, slope, strict=True)]
        off = [[a + off_mm * s, s] for a, s in off]
        square = sum((weight * a * a).sum((1, 2)) for a, _ in off)
        mean = np.stack([(weight * a).sum((1, 2)) for a in at], axis=-1)
        psfs = tuple(
            ray_epsf(
                off[0][0][k].ravel() / self.pitch_mm,
                -off[1][0][k].ravel() / self.pitch_mm,
                weight[k].ravel(),
                diffusion_px=self.blur_px,
                half_size_px=8,
            )
            for k in NEA_PLACES
        )
        self.area = float(light.mean()) if self.area is None else self.area
        config, noise = self.prediction.config, self.prediction.processing.noise
        found = predict_centroids(
            "epsf",
            psfs,
            np.array([self.electrons * light.mean() / self.area]),
            noise=noise,
            background_e=self.prediction.processing.frame.background_e,
            window_px=config.window_px,
            phases=4,  # two miss the middle of the pixel, where a sharp spot is worst
        )
        nea = float(np.sqrt((found.noise_px**2).mean()))
        return _Traced(mean / self.pitch_mm * [1.0, -1.0], square * 1e6, nea, off_mm)


def moves_of(lens: LensSystem, config: ManufactureConfig) -> dict[str, Move]:
    """Perturbations, and their movement by a number of standard deviations; compensated focus is set afterwards."""
    return dict(_moves(lens, config))


def _moved(move: Callable[..., LensSystem], at: Any, key: str, sigma: float) -> Move:
    """A change of an element or a surface by a number of standard deviations."""
    return lambda lens, number: move(lens, at, **{key: number * sigma})


def _moves(lens: LensSystem, config: ManufactureConfig) -> Iterator[tuple[str, Move]]:
    for name in lens.elements:
        surfaces = lens.indices_of(name)
        last = surfaces[-1]
        glass = tuple(i for i in surfaces if lens.surfaces[i].medium != AMBIENT and not lens.surfaces[i].mirror)
        for axis in "xy":
            if config.decentre_um:
                yield f"decentre {axis} of {name}", _moved(decentre, name, f"{axis}_mm", config.decentre_um * UM_MM)
            if config.tilt_arcmin:
                yield f"tilt {axis} of {name}", _moved(tilt, name, f"{axis}_deg", config.tilt_arcmin / 60.0)
            if config.wedge_arcmin and glass:
                yield f"wedge {axis} of {name}", _moved(tilt, last, f"{axis}_deg", config.wedge_arcmin / 60.0)
        if config.thickness_um:
            longer = partial(despace, following=True)
            yield f"thickness of {name}", _moved(longer, last, "z_mm", config.thickness_um * UM_MM)
        if config.index and glass:
            yield f"index of {name}", _moved(change_index, glass, "by", config.index)
        for i in surfaces if config.radius_percent else ():
            radius = getattr(lens.surfaces[i].shape, "radius_mm", np.inf)
            if np.isfinite(radius) and radius:
                change = partial(change_shape, name="radius_mm")
                yield f"radius of {lens.label(i)}", _moved(change, i, "by", radius * config.radius_percent / 100.0)


def built_lens(lens: LensSystem, moves: dict[str, Move], amounts: FloatArray) -> LensSystem:
    """The lens with every move made by its number of standard deviations."""
    for move, amount in zip(moves.values(), amounts, strict=True):
        lens = move(lens, float(amount))
    return lens


def manufactured(
    prediction: CameraPrediction, limits: dict[str, tuple[float, bool]], *, advance: Callable[[], None] = lambda: None
) -> Manufactured:
    """Draw lenses and trace them.

    Raises
    ------
    DomainError
        If fewer than two lenses have an image.
    """
    config: Config = prediction.config
    setting, lens = config.manufacture, prediction.state.sensor.camera.focused_lens
    lens.check_surfaces()
    probe, moves = _Probe(prediction), moves_of(lens, setting)
    nominal, reference = probe.trace(lens, refocused=False), probe.trace(lens, refocused=setting.refocused)
    rng = Streams(config.seed).generator("manufacture")
    shape = (setting.lenses, len(moves) + 1)
    uniform = setting.distribution == "uniform"
    amounts = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), shape) if uniform else rng.standard_normal(shape)
    found, lenses = [], []
    for *drawn, focus in amounts:
        try:
            off_mm = float(focus) * setting.focus_um * UM_MM
            made = built_lens(lens, moves, np.array(drawn))
            found.append(probe.trace(made, refocused=setting.refocused, off_mm=off_mm))
            lenses.append(drawn)
        except (ConvergenceError, DomainError):
            pass
        advance()
    if len(found) < 2:
        raise DomainError(
            f"{len(found)} of {setting.lenses} lenses form an image; lower the tolerances of [manufacture]"
        )
    ends = [
        [probe.trace(move(lens, sign), refocused=setting.refocused) for sign in (1.0, -1.0)] for move in moves.values()
    ]
    basis = probe.rigid(setting.refocused)
    pixel = prediction.state.pixel_arcsec
    before = np.array([_left(basis, (one.map_px - nominal.map_px).ravel()) for one in found]) * pixel
    cubic = _cubic(probe.place_px)
    after = pixel * np.array([_calibrated(cubic, one.map_px) for one in found])
    ratio = np.array([one.nea for one in found]) / nominal.nea
    noise, total = prediction.value("attitude_cross_noise_arcsec"), prediction.value("attitude_cross_arcsec")
    nea = prediction.value("nea_arcsec") * ratio
    across = np.sqrt(np.maximum(total**2 - noise**2, 0.0) + (noise * ratio) ** 2)
    spot = np.sqrt([one.square_um2.max() for one in found]) * UM_MM / probe.pitch_mm
    met = np.ones(len(found), bool)
    for name, values in zip(JUDGED, (nea, across, spot, before, after), strict=True):
        if name in limits:
            met &= values <= limits[name][0]
    rank = np.argsort(ratio)
    at = [int(rank[round(share * (len(found) - 1))]) for share in CHOSEN]
    chosen = tuple(
        (_at_detector(built_lens(lens, moves, np.array(lenses[k])), found[k].off_mm), float(ratio[k])) for k in at
    )
    single = np.array([_left(basis, (up.map_px - down.map_px).ravel() / 2.0) for up, down in ends]) * pixel
    growth = np.array([(0.5 * (up.square_um2 + down.square_um2) - reference.square_um2).mean() for up, down in ends])
    order = np.argsort(-growth / growth.max(initial=1e-30) - single / single.max(initial=1e-30))[:MOST]
    return Manufactured(
        built_lenses=len(found),
        built_lost=setting.lenses - len(found),
        built_yield=float(met.sum() / setting.lenses),
        built_arcsec=np.array([np.percentile(one, PERCENT) for one in (nea, across, before, after)]),
        built_nominal_arcsec=np.array(
            [prediction.value("nea_arcsec"), total, 0.0, pixel * _calibrated(cubic, nominal.map_px)]
        ),
        built_spot_px=np.percentile(spot, PERCENT),
        built_rms_arcsec=float(np.sqrt((before**2).mean())),
        built_linear_arcsec=float(np.sqrt((single**2).sum())),
        offender_lsfe_arcsec=single[order],
        offender_spot_um2=growth[order],
        offenders=tuple(np.array(list(moves), dtype=object)[order]),
        chosen=chosen,
    )


def yield_line(found: Manufactured) -> str:
    """Line on the yield for the terminal."""
    nea_arcsec = found.built_arcsec[0, PERCENT.index(95)]
    drawn = found.built_lenses + found.built_lost
    words = f"{100.0 * found.built_yield:.3g} % of {drawn} lenses meet their requirements"
    return f"{'Yield':<19} {words}; NEA of 95 %: {nea_arcsec:.3g}\u2033"


def _at_detector(lens: LensSystem, off_mm: float) -> LensSystem:
    return replace(lens, image_position_mm=lens.image_position_mm + off_mm * lens.image_rotation[:, 2])


def _cubic(place_px: FloatArray) -> FloatArray:
    """Monomials up to the third degree at places (n, 2), scaled to -1 ... 1: (n, 10)."""
    x, y = (place_px / np.abs(place_px).max(0)).T
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)


def _left(basis: FloatArray, values: FloatArray) -> float:
    """RMS per axis of what a least-squares fit leaves; free parameters are counted."""
    left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.sqrt((left**2).sum() / (len(values) - basis.shape[1])))


def _calibrated(cubic: FloatArray, map_px: FloatArray) -> float:
    """RMS per axis of what a polynomial of each axis leaves."""
    return float(np.sqrt(np.mean([_left(cubic, map_px[:, k]) ** 2 for k in (0, 1)])))


def _axes(q: Quantities, found: Manufactured) -> None:
    q.axis("built", list(SHOWN), "Error", key="error", names=list(SHOWN.values()))
    q.axis("percentile", [str(p) for p in PERCENT], "Share of the lenses", names=[f"{p} %" for p in PERCENT])
    q.axis("offender", np.array(found.offenders, dtype=object), "Tolerance, one standard deviation", key="tolerance")


MANUFACTURED = Section(
    record=Manufactured,
    axes=_axes,
    table="manufactured",
    rows="built",
    across="percentile",
    columns="built_nominal_arcsec built_arcsec",
    caption="Manufactured lenses: value not exceeded by the stated fraction of lenses; one standard deviation.",
    figures={"offenders": bars("offender", bars="offender_lsfe_arcsec", aspect_ratio=0.5)},
)
RENDERED_LENSES = Section(
    record=RenderedLens,
    dim="drawn",
    prefix="rendered_",
    place="rendered_lenses[drawn]",
    table="rendered_lenses",
    rows="drawn",
    hidden="drawn",
    caption="Three manufactured lenses in rendered frames: NEA of the chart's stars, one axis, 1σ.",
)
