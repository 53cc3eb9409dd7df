"""What a user can get wrong with the bench, found from its geometry, and the closed form of the spot."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from experiments.cube.settings import Config
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry, CubePose
from render.detector.spec import Detector

__all__ = ["check_bench", "check_landing", "check_light_levels", "reflected_spot_mm", "spot_profile"]


RIM_PX = 8.0
"""Rim of the spot that must show around the aperture."""


def check_bench(config: Config, geometry: BenchGeometry, camera: BenchCamera) -> None:
    """Refuse a bench that cannot work."""
    hole, face = geometry.aperture_mm, geometry.face_mm
    blur = geometry.blur_mm(geometry.path_mm)
    if face < hole:
        raise DomainError(
            f"the aperture of {hole:g} mm is larger than the spot, which a face of {face:g} mm cuts down; the spot "
            "must show around the aperture (screen.aperture_mm, cube.side_mm)"
        )
    rim_px = blur / camera.pitch_mm
    if rim_px < RIM_PX:
        raise DomainError(
            f"the aperture of {hole:g} mm is as large as the spot of {hole + 2 * blur:.4g} mm: a rim of {rim_px:.2g} "
            f"px shows around it, at least {RIM_PX:g} px are needed; make simulator.source_arcmin = "
            f"{config.simulator.source_arcmin:g} or screen.distance_mm larger"
        )
    beam = hole + 2 * geometry.blur_mm(geometry.distance_mm)
    if beam > face:
        raise DomainError(
            f"the beam is {beam:.4g} mm wide at the cube, its face only {face:g} mm; make cube.side_mm larger or "
            "screen.aperture_mm or simulator.source_arcmin smaller"
        )
    start = config.trim.start_px * camera.pitch_mm
    _check_spot(config, geometry, camera, np.array([start, start]), "trim.start_px")


def check_light_levels(config: Config, detector: Detector, sensor_detector: Detector) -> None:
    """Refuse exposures that saturate."""
    for key, plateau_e, chip in (
        ("camera.plateau_e", config.camera.plateau_e, detector),
        ("sensor.plateau_e", config.sensor.plateau_e, sensor_detector),
    ):
        limit = 0.9 * min(chip.full_well_e, (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e)
        if plateau_e > limit:
            raise DomainError(
                f"{key} = {plateau_e:g} e- saturates {chip.name!r}; at most {limit:.4g} e- (0.9 of full well and "
                "converter) are allowed"
            )


def _check_spot(config: Config, geometry: BenchGeometry, camera: BenchCamera, spot_mm: FloatArray, hint: str) -> None:
    """The whole spot must be on the screen and in the picture."""
    reach = geometry.aperture_mm / 2 + geometry.blur_mm(geometry.path_mm)
    edge = float(np.max(np.abs(spot_mm)) + reach)
    if edge > geometry.screen_mm / 2:
        raise DomainError(
            f"the spot is off the screen: it reaches {edge:.4g} mm from the aperture, the screen "
            f"{geometry.screen_mm / 2:g} mm; align the cube better by eye ({hint}) or make screen.side_mm larger"
        )
    angle = 2 * np.pi * np.arange(16) / 16
    rim = spot_mm + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    pixel = camera.to_pixel(rim)
    limit = np.array([camera.width_px, camera.height_px]) - 0.5
    if np.any(pixel < -0.5) or np.any(pixel > limit):
        raise DomainError(
            f"the spot of {2 * reach:.4g} mm, {spot_mm[0]:.4g}, {spot_mm[1]:.4g} mm from the aperture, is not wholly "
            f"in the picture of {camera.width_px} x {camera.height_px} px of {camera.pitch_mm * 1e3:g} um; start "
            f"nearer ({hint}) or take a detector with more pixels (camera.detector)"
        )


def check_landing(config: Config, geometry: BenchGeometry, camera: BenchCamera, pose: CubePose, face: str) -> None:
    """Refuse a pose in which the beam misses the face or the spot is lost."""
    centre, normal = pose.face(face, geometry)
    if normal[2] < 0.5:
        raise DomainError(f"face {face} does not look at the light; the table stands wrong")
    depth = (centre @ normal) / -normal[2]  # along the beam, from the aperture
    hit = np.array([0.0, 0.0, -depth]) - centre
    across = np.abs(pose.rotation.T @ hit)
    half, beam = geometry.face_mm / 2, geometry.aperture_mm / 2 + geometry.blur_mm(geometry.distance_mm)
    worst = float(np.sort(across)[-1])
    if worst + beam > half:
        how = "misses" if worst - beam > half else "is cut by the edge of"
        raise DomainError(
            f"the beam {how} face {face}: it falls {worst:.4g} mm from the middle of a polished face of "
            f"{geometry.face_mm:g} mm; bring cube.offset_mm nearer to the axes of the table or take a larger cube"
        )
    _check_spot(config, geometry, camera, reflected_spot_mm(geometry, pose, face), "trim.start_px, cube.mount_arcmin")


def reflected_spot_mm(geometry: BenchGeometry, pose: CubePose, face: str) -> FloatArray:
    """Where the middle of the beam lands on the screen (2,), by the law of reflection."""
    centre, normal = pose.face(face, geometry)
    light = np.array([0.0, 0.0, -1.0])
    hit = light * ((centre @ normal) / (light @ normal))
    back = light - 2 * (light @ normal) * normal
    return np.asarray((hit - back * (hit[2] / back[2]))[:2])


def spot_profile(geometry: BenchGeometry, radius_mm: ArrayLike) -> FloatArray:
    """Irradiance of the spot over that of the beam at distances from its centre: aperture convolved with the Sun.

    A point sees the Sun, in the mirror, through the aperture: the visible part of the Sun's disk is the overlap of two
    circles, the aperture (radius a) and the Sun's image over the whole path (radius b), r apart. The path counts from
    the aperture to the face and back; that the aperture is crossed 20 mm behind the simulator changes nothing.
    """
    a, b = geometry.aperture_mm / 2, geometry.blur_mm(geometry.path_mm)
    r = np.maximum(np.asarray(radius_mm, float), 1e-12)
    cos_a = np.clip((r**2 + a**2 - b**2) / (2 * r * a), -1, 1)
    cos_b = np.clip((r**2 + b**2 - a**2) / (2 * r * b), -1, 1)
    angle_a, angle_b = np.arccos(cos_a), np.arccos(cos_b)
    lens = a**2 * (angle_a - np.sin(2 * angle_a) / 2) + b**2 * (angle_b - np.sin(2 * angle_b) / 2)
    lens = np.where(r >= a + b, 0.0, np.where(r <= abs(a - b), np.pi * min(a, b) ** 2, lens))
    return np.asarray(lens / (np.pi * b**2))
