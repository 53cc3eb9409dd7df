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

from calib.measure.targets.screen_circles import (
    ScreenPicture,
    SpotOffset,
    fit_aperture,
    fit_hole,
    fit_spot,
    measure_offset,
)
from experiments.cube.bench import Case, Laboratory, Truth, check_landing, put_cube, start_angles
from experiments.cube.settings import Config
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.units import ARCSEC_RAD, RAD_DEG
from render.bench.pictures import screen_picture
from render.bench.scene import CubePose
from render.bench.spot import reflected_spot_mm
from render.engine.random import Streams

INNER_MARGIN_PX = 2.0
ROUGH_PX, ROUGH_LOG2 = 3.0, 2
"""Pictures that will show a larger offset than this take a quarter of the particles: they only steer."""

BETTER_LIGHT = "is it in the picture and bright enough? (camera.plateau_e, simulator.source_arcmin, trim.start_px)"


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
    offset: SpotOffset  # The last one
    # The same with the aperture seen as the dark hole in the picture of the spot: no give of the mount between two
    # pictures enters. Taken where the spot is trimmed coarsely; otherwise the same as ``offset``
    own: SpotOffset
    pictures: tuple[ScreenPicture, ...] = ()  # Aperture, first spot, last spot, where they were kept


def exposed(laboratory: Laboratory, electrons: NDArray[np.float32], streams: Streams) -> ScreenPicture:
    """Picture of expected electrons (h, w): noise of light and detector, read out."""
    exposure_s = laboratory.config.camera.exposure_s
    read = screen_picture(electrons, laboratory.detector, streams, exposure_s)
    return ScreenPicture(electrons=read, camera=laboratory.camera)


def take_spot(
    laboratory: Laboratory,
    streams: Streams,
    *,
    sensor: Any,
    log2_particles: int,
    inner_mm: float = 0.0,
) -> ScreenPicture:
    """Picture of the spot, with the cube of the scene where it is."""
    light = laboratory.light(
        sensor, covered=False, log2_particles=log2_particles, seed=streams.key("particles") >> 1, inner_mm=inner_mm
    )
    return exposed(laboratory, light, streams.child("spot"))


def moved_sensor(laboratory: Laboratory, shift_mm: FloatArray) -> Any:
    """The camera of Mitsuba after its mount gave way: its aim is off by ``-shift_mm``, so the picture moves by it."""
    if not np.any(shift_mm):
        return laboratory.sensor
    return replace(laboratory.camera, aim_mm=laboratory.camera.aim_mm - shift_mm).sensor()


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
    glowing = exposed(laboratory, laboratory.aperture_e, streams.child("aperture"))
    aperture = fit_aperture(glowing, laboratory.geometry.aperture_mm / 2, advice=BETTER_LIGHT)
    ahead_px = _start_px(config, case)
    commanded = start_angles(laboratory, truth, table, face, repeat, within_px=ahead_px)
    rows: list[TrimRow] = []
    pictures: tuple[ScreenPicture, ...] = (glowing,) if keep else ()
    for setting in range(config.trim.allowed):
        here = streams.child("setting", setting)
        actual = table.set(commanded[None], here)
        pose = put_cube(laboratory, truth, table.rotation(actual)[0].as_matrix())
        particles = log2_particles - (ROUGH_LOG2 if ahead_px > ROUGH_PX else 0)
        picture = _look(laboratory, pose, name, here, sensor=sensor, log2_particles=particles)
        spot = fit_spot(picture, aperture, spot_reach_mm(laboratory), advice=BETTER_LIGHT)
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
            own = (
                measure_offset(fit_hole(picture, aperture, advice=BETTER_LIGHT), spot, laboratory.pitch_mm)
                if case.coarse
                else offset
            )
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
) -> ScreenPicture:
    """Picture of the spot with the cube at a pose, after a check that the beam reaches the camera."""
    geometry = laboratory.geometry
    check_landing(laboratory.config, geometry, laboratory.camera, pose, face)
    displaced = float(np.hypot(*reflected_spot_mm(geometry, pose, face)))
    inner = geometry.aperture_mm / 2 - displaced - INNER_MARGIN_PX * laboratory.pitch_mm
    return take_spot(laboratory, streams, sensor=sensor, log2_particles=log2_particles, inner_mm=max(inner, 0.0))


def _bright_enough(config: Config, offset: SpotOffset) -> None:
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


def _row(angle_rad: FloatArray, offset: SpotOffset) -> TrimRow:
    outer, inner = (angle_rad * RAD_DEG).tolist()
    return TrimRow(outer_deg=outer, inner_deg=inner, offset_px=offset.offset_px, sigma_px=offset.sigma_px)


def spot_reach_mm(laboratory: Laboratory) -> float:
    """Radius of the whole spot."""
    geometry = laboratory.geometry
    return geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
