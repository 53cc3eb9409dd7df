"""Trimming of a face until spot and aperture are concentric: pictures, circle fits, and the operator (CUBE09, step 2).

Two pictures, as published: first the reflected light is blocked and the aperture is imaged (here glowing behind a sheet
of tracing paper); then the light is admitted and the spot is imaged around the hole. The spot is as wide as the
aperture plus the sun's image over twice the distance, so that only its rim is visible around the hole; the contour
fitted to it is low on the rim. The edge of the hole in the same picture also gives the aperture (improved procedure).

Edges are transformed from the picture to the plane of the screen before the circles are fitted, so that the oblique
view has no effect. Offsets are (x, y) in the laboratory, spot minus aperture, in pixels of the screen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.circle_edge import EdgePoints, edge_crossings, sample_spokes, smoothed
from calib.measure.circle_fit import CircleFit, fit_circle
from experiments.cube.bench import (
    Case,
    Laboratory,
    Truth,
    check_landing,
    electrons_per_radiance,
    put_cube,
    reflected_spot_mm,
    start_angles,
)
from experiments.cube.settings import Config
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.units import ARCSEC_RAD, RAD_DEG
from render.bench.camera import BenchCamera
from render.bench.scene import CubePose
from render.bench.trace import trace_screen
from render.detector.diffusion import diffuse
from render.detector.readout import expose
from render.engine.random import Streams

RIM_LEVEL = 0.3
"""Contour of the spot, as part of the brightest rim."""

SPOKES, RAYS = 90, 3
HOLE_MARGIN_PX = 4.0
INNER_MARGIN_PX = 2.0
ROUGH_PX, ROUGH_LOG2 = 3.0, 2
"""Pictures that will show a larger offset than this take a quarter of the particles: they only steer."""

BESIDE_PX = (2.5, 7.0)
"""Part of the rim, from the hole's edge, whose brightness a line carries to the edge."""
BETTER_LIGHT = "is it in the picture and bright enough? (camera.plateau_e, simulator.source_arcmin, trim.start_px)"
EDGE_HALF_WIDTH_PX = {"aperture": 1.5, "spot": 14.0, "hole": 1.5}


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A read-out picture of the screen."""

    electrons: FloatArray  # (h, w) (DN - offset) / gain
    camera: BenchCamera  # The camera as it is believed to stand


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Spot minus aperture."""

    offset_px: FloatArray  # (2,) x and y in the laboratory, in pixels of the screen
    covariance_px2: FloatArray  # (2, 2) From the two circle fits
    spot: CircleFit  # In mm on the screen
    aperture: CircleFit


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimRow:
    """One setting of the table, as in Table 1 of CUBE09."""

    outer_deg: float  # Where the table was sent
    inner_deg: float
    offset_px: FloatArray  # (2,) What the pictures say
    sigma_px: FloatArray  # (2,) Standard deviations of that


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceTrim:
    """A trimmed face."""

    face: str  # Which
    rows: tuple[TrimRow, ...]  # The trims
    reading_rad: FloatArray  # (2,) Outer and inner angle that were read at the end
    offset: Offset  # The last one
    # The same with the aperture seen as the dark hole in the picture of the spot: no give of the mount between two
    # pictures enters. Taken where the spot is trimmed coarsely; otherwise the same as ``offset``
    own: Offset
    pictures: tuple[Picture, ...] = ()  # Aperture, first spot, last spot, where they were kept


def exposed(laboratory: Laboratory, electrons: NDArray[np.float32], streams: Streams) -> Picture:
    """Picture of expected electrons (h, w): noise of light and detector, read out."""
    frame = expose(
        electrons,
        laboratory.detector,
        streams=streams,
        exposure_s=laboratory.config.camera.exposure_s,
    )
    dn = frame.dn.astype(np.float64)
    return Picture(electrons=(dn - frame.offset_dn) / frame.gain_dn_per_e, camera=laboratory.camera)


def take_aperture(laboratory: Laboratory, streams: Streams) -> Picture:
    """Picture of the covered aperture; the light is the same every time, the noise is not."""
    return exposed(laboratory, laboratory.aperture_e, streams.child("aperture"))


def take_spot(
    laboratory: Laboratory,
    streams: Streams,
    *,
    sensor: Any,
    log2_particles: int,
    inner_mm: float = 0.0,
) -> Picture:
    """Picture of the spot, with the cube of the scene where it is."""
    light = spot_light(laboratory, streams, sensor=sensor, log2_particles=log2_particles, inner_mm=inner_mm)
    return exposed(laboratory, light, streams.child("spot"))


def spot_light(
    laboratory: Laboratory, streams: Streams, *, sensor: Any, log2_particles: int, inner_mm: float = 0.0
) -> NDArray[np.float32]:
    """Expected electrons (h, w) of a picture of the spot, but for the number of particles."""
    light = trace_screen(
        laboratory.scene,
        sensor,
        laboratory.camera,
        laboratory.geometry,
        covered=False,
        log2_particles=log2_particles,
        inner_mm=inner_mm,
        seed=streams.key("particles") >> 1,
    )
    scaled = light * np.float32(electrons_per_radiance(laboratory.config))
    return diffuse(scaled, laboratory.detector.diffusion_sigma_px)


def moved_sensor(laboratory: Laboratory, shift_mm: FloatArray) -> Any:
    """The camera of Mitsuba after its mount gave way: its aim is off by ``-shift_mm``, so the picture moves by it."""
    if not np.any(shift_mm):
        return laboratory.sensor
    return replace(laboratory.camera, aim_mm=laboratory.camera.aim_mm - shift_mm).sensor()


def _spokes(picture: Picture, centre_mm: FloatArray, low_mm: float, high_mm: float, step_px: float = 0.5) -> Any:
    radius = np.arange(low_mm, high_mm, step_px * picture.camera.pitch_mm)
    return sample_spokes(
        picture.electrons, centre_mm, radius, to_pixel=picture.camera.to_pixel, spokes=SPOKES, rays=RAYS
    )


def fit_aperture(picture: Picture, radius_mm: float) -> CircleFit:
    """Circle through the edge of the glowing aperture: half the brightness of its inside."""
    width = EDGE_HALF_WIDTH_PX["aperture"] * picture.camera.pitch_mm
    centre, moved = np.zeros(2), np.inf
    while moved > 2.0 * picture.camera.pitch_mm:
        spokes = _spokes(picture, centre, 0.6 * radius_mm, radius_mm + 12 * picture.camera.pitch_mm)
        inside = spokes.radius < 0.85 * radius_mm
        outside = spokes.radius > radius_mm + 8 * picture.camera.pitch_mm
        level = 0.5 * (np.nanmedian(spokes.value[:, inside]) + np.nanmedian(spokes.value[:, outside]))
        edge = edge_crossings(spokes, level, rising=False, half_width=width)
        fit = _circle(edge, "aperture")
        moved, centre = float(np.hypot(*(fit.centre - centre))), fit.centre
    return fit


def fit_spot(picture: Picture, aperture: CircleFit, reach_mm: float) -> CircleFit:
    """Circle through a contour low on the rim of the spot, where it shows outside the hole."""
    pitch = picture.camera.pitch_mm
    width = EDGE_HALF_WIDTH_PX["spot"] * pitch
    centre = _brightest(picture, aperture)
    for _ in range(2):
        spokes = _spokes(picture, centre, 0.5 * aperture.radius, reach_mm + 25 * pitch, 1.0)
        dark = np.nanmedian(spokes.value[:, -8:])
        rim = np.nanmax(smoothed(spokes, width), axis=1)
        level = dark + RIM_LEVEL * (np.nanpercentile(rim, 90) - dark)
        edge = edge_crossings(spokes, level, rising=False, half_width=width)
        edge = edge.outside(aperture.centre, aperture.radius + HOLE_MARGIN_PX * pitch)
        fit = _circle(edge, "spot")
        centre = fit.centre
    return fit


def fit_hole(picture: Picture, aperture: CircleFit) -> CircleFit:
    """Circle through the dark edge of the hole in the picture of the spot, each spoke at half its own brightness."""
    pitch = picture.camera.pitch_mm
    width = EDGE_HALF_WIDTH_PX["hole"] * pitch
    centre, moved = aperture.centre, np.inf
    while moved > 2.0 * pitch:
        spokes = _spokes(picture, centre, 0.6 * aperture.radius, aperture.radius + 9 * pitch)
        inside = spokes.radius < aperture.radius - 5 * pitch
        out_px = (spokes.radius - aperture.radius) / pitch
        beside = (out_px > BESIDE_PX[0]) & (out_px < BESIDE_PX[1])
        dark = np.nanmedian(spokes.value[:, inside])
        at_edge = _lines(spokes.radius[beside] - aperture.radius, spokes.value[:, beside])
        edge = edge_crossings(spokes, 0.5 * (dark + at_edge), rising=True, half_width=width)
        fit = _circle(edge, "edge of the hole")
        moved, centre = float(np.hypot(*(fit.centre - centre))), fit.centre
    return fit


def _circle(edge: EdgePoints, what: str) -> CircleFit:
    """Circle whose covariance follows from the scatter of the points about it: the lines through a curved edge leave
    equal residuals on every spoke, which are no noise."""
    if len(edge) < SPOKES // 6:
        raise ConvergenceError(f"the {what} shows only {len(edge)} edge points on {SPOKES} spokes; {BETTER_LIGHT}")
    fit = fit_circle(edge.point, sigma=edge.sigma)
    if not fit.converged:
        why = fit.message.partition(";")[0]
        raise ConvergenceError(
            f"the {len(edge)} edge points of the {what} do not form a circle ({why}); {BETTER_LIGHT}"
        )
    return replace(fit, covariance=fit.covariance * min(fit.misfit.ratio**2, 1.0))


def _lines(x: FloatArray, value: FloatArray) -> FloatArray:
    """Value at x = 0 of a line through each row."""
    return np.asarray(np.polynomial.polynomial.polyfit(x, value.T, 1)[0])


def _brightest(picture: Picture, aperture: CircleFit) -> FloatArray:
    """Rough centre of the spot: mean of the picture's light, the hole taken as evenly filled."""
    height, width = picture.electrons.shape
    step = 4
    row, column = np.mgrid[0:height:step, 0:width:step]
    light = picture.electrons[::step, ::step]
    light = np.clip(light - np.percentile(light, 20), 0, None)
    light = np.where(light > 0.05 * light.max(), light, 0.0)
    point = picture.camera.to_screen(np.column_stack([column.ravel(), row.ravel()]))
    weight = light.ravel()
    if not weight.sum() > 0:
        return aperture.centre
    return np.asarray((weight @ point) / weight.sum())


def measure_offset(aperture: CircleFit, spot: CircleFit, pitch_mm: float) -> Offset:
    """Difference of two fitted centres."""
    return Offset(
        offset_px=(spot.centre - aperture.centre) / pitch_mm,
        covariance_px2=(spot.covariance[:2, :2] + aperture.covariance[:2, :2]) / pitch_mm**2,
        spot=spot,
        aperture=aperture,
    )


def trim_face(
    laboratory: Laboratory,
    truth: Truth,
    case: Case,
    table: Turntable,
    face: int,
    repeat: int,
    *,
    streams: Streams,
    log2_particles: int,
    keep: bool = False,
) -> FaceTrim:
    """Turn a face to the light and trim the table until spot and aperture are concentric."""
    config, name = laboratory.config, laboratory.config.cube.faces[face]
    tilt = laboratory.tilt_per_px
    aim = case.aim_px * truth.aim[face, repeat]
    give = case.mounting * config.camera.mounting_arcsec * ARCSEC_RAD * laboratory.geometry.path_mm
    sensor = moved_sensor(laboratory, give * truth.mounting[face, repeat])
    glowing = take_aperture(laboratory, streams)
    aperture = fit_aperture(glowing, laboratory.geometry.aperture_mm / 2)
    ahead_px = _start_px(config, case)
    commanded = start_angles(laboratory, truth, table, face, repeat, within_px=ahead_px)
    rows: list[TrimRow] = []
    pictures: tuple[Picture, ...] = (glowing,) if keep else ()
    for setting in range(config.trim.allowed):
        here = streams.child("setting", setting)
        actual = table.set(commanded[None], here)
        pose = put_cube(laboratory, truth, table.rotation(actual)[0].as_matrix())
        particles = log2_particles - (ROUGH_LOG2 if ahead_px > ROUGH_PX else 0)
        picture = _look(laboratory, pose, name, here, sensor=sensor, log2_particles=particles)
        spot = fit_spot(picture, aperture, spot_reach_mm(laboratory))
        offset = measure_offset(aperture, spot, laboratory.pitch_mm)
        _bright_enough(config, offset)
        rows.append(_row(actual[0], offset))
        if keep:
            pictures = (*pictures[:2], picture)
        left = offset.offset_px - aim
        correction = tilt * np.array([left[1], -left[0]])
        if not case.coarse or np.all(np.abs(left) < config.trim.stop_px):
            # alone, a term starts trimmed: the table makes one last correction, which no picture has to confirm
            final = actual if case.coarse else actual + correction
            own = measure_offset(fit_hole(picture, aperture), spot, laboratory.pitch_mm) if case.coarse else offset
            return FaceTrim(
                face=name,
                rows=tuple(rows),
                reading_rad=table.read(final, here)[0],
                offset=offset,
                own=own,
                pictures=pictures,
            )
        commanded = actual[0] + config.trim.gain_ratio * correction
        ahead_px = float(np.max(np.abs((1 - config.trim.gain_ratio) * left)))
    raise ConvergenceError(
        f"face {name} is not concentric after trim.allowed = {config.trim.allowed} settings: offsets "
        f"{left[0]:.3f}, {left[1]:.3f} px where trim.stop_px = {config.trim.stop_px:g} px is required; allow more "
        "trims, "
        "a finer trim.step_deg or another trim.gain_ratio"
    )


def _look(
    laboratory: Laboratory, pose: CubePose, face: str, streams: Streams, *, sensor: Any, log2_particles: int
) -> Picture:
    """Picture of the spot with the cube at a pose, after a check that the beam reaches the camera."""
    geometry = laboratory.geometry
    check_landing(laboratory.config, geometry, laboratory.camera, pose, face)
    displaced = float(np.hypot(*reflected_spot_mm(geometry, pose, face)))
    inner = geometry.aperture_mm / 2 - displaced - INNER_MARGIN_PX * laboratory.pitch_mm
    return take_spot(laboratory, streams, sensor=sensor, log2_particles=log2_particles, inner_mm=max(inner, 0.0))


def _bright_enough(config: Config, offset: Offset) -> None:
    """Refuse a spot whose location is less accurate than the stop rule."""
    sigma = float(np.sqrt(np.trace(offset.covariance_px2) / 2))
    if not sigma < max(config.trim.stop_px, 1.0):
        raise ConvergenceError(
            f"the pictures locate the spot to {sigma:.2g} px only, trim.stop_px = {config.trim.stop_px:g} px is "
            f"required; more light is needed (camera.plateau_e = {config.camera.plateau_e:g} e-) or more particles "
            "(benches.log2_particles)"
        )


def _start_px(config: Config, case: Case) -> float:
    """How far off the first picture is: where the eye left the spot, or, for terms alone, already trimmed."""
    return config.trim.start_px if case.coarse else min(config.trim.stop_px, config.trim.start_px)


def _row(angle_rad: FloatArray, offset: Offset) -> TrimRow:
    outer, inner = (float(one) for one in angle_rad * RAD_DEG)
    sigma = np.sqrt(np.diag(offset.covariance_px2))
    return TrimRow(outer_deg=outer, inner_deg=inner, offset_px=offset.offset_px, sigma_px=sigma)


def spot_reach_mm(laboratory: Laboratory) -> float:
    """Radius of the whole spot."""
    geometry = laboratory.geometry
    return geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
