"""Adjustment of a face until spot and aperture are concentric: pictures, circle fits, operator (CUBE09, step 2).

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
from experiments.cube.bench import CubeCase, CubeLaboratory, TrueBench, check_landing, put_cube, start_angles
from experiments.cube.settings import CubeMirrorConfig
from experiments.laboratory.devices.turntable import Turntable
from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.units import ARCSEC_RAD, RAD_DEG
from render.bench.pictures import screen_picture
from render.bench.scene import CubePose
from render.bench.spot import reflected_spot_mm
from render.engine.random import Streams

INNER_MARGIN_PX = 2.0
"""Margin of the hole of the aperture, inside of which no particles are traced."""
COARSE_OFFSET_PX, COARSE_LOG2 = 3.0, 2
"""Expected offset above which a picture has a quarter of the particles (2^-2), because another setting follows."""

BETTER_LIGHT = "is it in the picture and bright enough? (camera.plateau_e, simulator.source_arcmin, trim.start_px)"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrimRow:
    """A setting of the table, as in Table 1 of CUBE09."""

    outer_deg: float
    inner_deg: float
    offset_px: FloatArray  # (2,) Measured in the pictures
    sigma_px: FloatArray  # (2,) Stated standard deviations


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceTrim:
    """A trimmed face."""

    face: str
    rows: tuple[TrimRow, ...]
    reading_rad: FloatArray  # (2,) Final readings of outer and inner angle
    offset: SpotOffset  # Remaining offset, from two pictures
    # Remaining offset from the last picture of the spot, whose dark hole is the aperture: free of the camera mount's
    # movement between two pictures. Equal to ``offset`` without a coarse adjustment
    one_picture_offset: SpotOffset
    pictures: tuple[ScreenPicture, ...] = ()  # Aperture, first spot, last spot; on request


def expose(laboratory: CubeLaboratory, electrons: NDArray[np.float32], streams: Streams) -> ScreenPicture:
    """Picture of expected electrons (h, w): noise of light and detector, read out."""
    exposure_s = laboratory.config.camera.exposure_s
    read = screen_picture(electrons, laboratory.detector, streams, exposure_s)
    return ScreenPicture(electrons=read, camera=laboratory.camera)


def take_spot(
    laboratory: CubeLaboratory,
    streams: Streams,
    *,
    sensor: Any,
    log2_particles: int,
    inner_mm: float = 0.0,
) -> ScreenPicture:
    """Picture of the spot with the cube of the scene at its present pose."""
    light = laboratory.light(
        sensor, covered=False, log2_particles=log2_particles, seed=streams.key("particles") >> 1, inner_mm=inner_mm
    )
    return expose(laboratory, light, streams.child("spot"))


def displaced_sensor(laboratory: CubeLaboratory, shift_mm: FloatArray) -> Any:
    """The Mitsuba sensor after a movement of the mount: the aim moves by ``-shift_mm``, the picture by ``shift_mm``."""
    if not np.any(shift_mm):
        return laboratory.sensor
    return replace(laboratory.camera, aim_mm=laboratory.camera.aim_mm - shift_mm).sensor()


def trim_face(
    laboratory: CubeLaboratory,
    truth: TrueBench,
    case: CubeCase,
    table: Turntable,
    face: int,
    repeat: int,
    *,
    streams: Streams,
    log2_particles: int,
    keep_pictures: bool = False,
) -> FaceTrim:
    """Turn a face to the light and adjust the table until spot and aperture are concentric."""
    config = laboratory.config
    name = config.cube.faces[face]
    movement_rad = case.mounting * config.camera.mounting_arcsec * ARCSEC_RAD * truth.mounting[face, repeat]
    sensor = displaced_sensor(laboratory, movement_rad * laboratory.geometry.path_mm)
    glowing = expose(laboratory, laboratory.aperture_e, streams.child("aperture"))
    aperture = fit_aperture(glowing, laboratory.geometry.aperture_mm / 2, advice=BETTER_LIGHT)
    expected_px = _start_px(config, case)
    commanded = start_angles(laboratory, truth, table, face, repeat, within_px=expected_px)
    rows: list[TrimRow] = []
    pictures: tuple[ScreenPicture, ...] = (glowing,)
    for setting in range(config.trim.allowed):
        setting_streams = streams.child("setting", setting)
        actual = table.set(commanded[None], setting_streams)
        pose = put_cube(laboratory, truth, table.rotation(actual)[0].as_matrix())
        particles = log2_particles - (COARSE_LOG2 if expected_px > COARSE_OFFSET_PX else 0)
        picture = _spot_picture(laboratory, pose, name, setting_streams, sensor=sensor, log2_particles=particles)
        spot = fit_spot(picture, aperture, spot_reach_mm(laboratory), advice=BETTER_LIGHT)
        offset = measure_offset(aperture, spot, laboratory.pitch_mm)
        _check_brightness(config, offset)
        rows.append(_trim_row(actual[0], offset))
        pictures = (*pictures[:2], picture)
        perceived_px = offset.offset_px - case.aim_px * truth.aim[face, repeat]
        correction = laboratory.tilt_per_px * np.array([perceived_px[1], -perceived_px[0]])
        if not case.coarse or np.all(np.abs(perceived_px) < config.trim.stop_px):
            # A single term starts concentric: one correction, without a picture to confirm it
            final = actual if case.coarse else actual + correction
            one_picture_offset = (
                measure_offset(fit_hole(picture, aperture, advice=BETTER_LIGHT), spot, laboratory.pitch_mm)
                if case.coarse
                else offset
            )
            return FaceTrim(
                face=name,
                rows=tuple(rows),
                reading_rad=table.read(final, setting_streams)[0],
                offset=offset,
                one_picture_offset=one_picture_offset,
                pictures=pictures if keep_pictures else (),
            )
        commanded = actual[0] + config.trim.gain_ratio * correction
        expected_px = float(np.max(np.abs((1 - config.trim.gain_ratio) * perceived_px)))
    raise ConvergenceError(
        f"face {name} is not concentric after trim.allowed = {config.trim.allowed} settings: offsets "
        f"{perceived_px[0]:.3f}, {perceived_px[1]:.3f} px where trim.stop_px = {config.trim.stop_px:g} px is required; "
        "allow more trims, a finer trim.step_deg or another trim.gain_ratio"
    )


def _spot_picture(
    laboratory: CubeLaboratory, pose: CubePose, face: str, streams: Streams, *, sensor: Any, log2_particles: int
) -> ScreenPicture:
    """Picture of the spot with the cube at a pose, after a check that the beam reaches the camera."""
    geometry = laboratory.geometry
    check_landing(laboratory.config, geometry, laboratory.camera, pose, face)
    offset_mm = float(np.hypot(*reflected_spot_mm(geometry, pose, face)))
    inner = geometry.aperture_mm / 2 - offset_mm - INNER_MARGIN_PX * laboratory.pitch_mm
    return take_spot(laboratory, streams, sensor=sensor, log2_particles=log2_particles, inner_mm=max(inner, 0.0))


def _check_brightness(config: CubeMirrorConfig, offset: SpotOffset) -> None:
    """Refuse a spot whose location is less accurate than the stopping criterion."""
    sigma = float(np.sqrt(np.trace(offset.covariance_px2) / 2))
    if not sigma < max(config.trim.stop_px, 1.0):
        raise ConvergenceError(
            f"the pictures locate the spot to {sigma:.2g} px only, trim.stop_px = {config.trim.stop_px:g} px is "
            f"required; more light is needed (camera.plateau_e = {config.camera.plateau_e:g} e-) or more particles "
            "(benches.log2_particles)"
        )


def _start_px(config: CubeMirrorConfig, case: CubeCase) -> float:
    """Largest offset in the first picture: of a spot set by eye, or, for single terms, of an adjusted face."""
    return config.trim.start_px if case.coarse else min(config.trim.stop_px, config.trim.start_px)


def _trim_row(angle_rad: FloatArray, offset: SpotOffset) -> TrimRow:
    """Row of Table 1 of CUBE09."""
    outer, inner = (angle_rad * RAD_DEG).tolist()
    return TrimRow(outer_deg=outer, inner_deg=inner, offset_px=offset.offset_px, sigma_px=offset.sigma_px)


def spot_reach_mm(laboratory: CubeLaboratory) -> float:
    """Radius of the spot including its blurred edge."""
    geometry = laboratory.geometry
    return geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
