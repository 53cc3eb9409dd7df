"""Camera, motion and placement from the properties of ``lens_camera`` (`render.plugins.lens_camera`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optics.errors import ConfigError
from optics.lens_file import load_lens
from optics.units import UM_MM
from render.camera import Camera
from render.plugins.handles import Handles, rotation_of
from render.tracing.motion.exposure import ExposureMotion

_MITSUBA_FROM_CAM = np.diag([-1.0, -1.0, 1.0])
"""Mitsuba's local frame has +X to the left and +Y up in the image; cam has +X to the right and +Y down."""

CAMERAS: Handles[Camera] = Handles(Camera, "camera")
MOTIONS: Handles[ExposureMotion] = Handles(ExposureMotion, "motion")


def share_camera(camera: Camera) -> str:
    """Handle by which ``load_dict`` takes a camera record, see `render.plugins.handles`."""
    return CAMERAS.share(camera)


def share_motion(motion: ExposureMotion) -> str:
    """Handle by which ``load_dict`` takes a motion, see `render.plugins.handles`."""
    return MOTIONS.share(motion)


def lens_camera_properties(camera: Camera, **others: Any) -> dict[str, Any]:
    """Dictionary for ``load_dict``: a ``lens_camera`` of a record, a grey float32 film of its size, and ``others``."""
    film = {
        "type": "hdrfilm",
        "width": camera.width_px,
        "height": camera.height_px,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return {"type": "lens_camera", "camera": share_camera(camera), "film": film, **others}


def _rotation(props: Any) -> np.ndarray:
    """cam from world, float64, from ``rotation`` or ``to_world``."""
    rotation = rotation_of(props, "lens_camera")
    if rotation is not None:
        return rotation
    if "to_world" in props:
        matrix = np.array(props["to_world"].matrix, dtype=float)[:3, :3]
        u, scales, vt = np.linalg.svd(matrix)
        if not np.allclose(scales, 1.0, atol=1e-5):
            raise ConfigError(f"lens_camera: to_world scales by {scales.max():g}; give scene_unit_mm instead")
        return _MITSUBA_FROM_CAM @ (u @ vt).T
    return _MITSUBA_FROM_CAM


def _shared_camera(props: Any, width: int, height: int) -> Camera:
    """The camera of a handle or a file."""
    camera = CAMERAS.named(str(props["camera"]))
    if (camera.width_px, camera.height_px) != (width, height):
        raise ConfigError(
            f"lens_camera: film of {width} x {height} px for a camera of {camera.width_px} x {camera.height_px} px"
        )
    if "rotation" in props or (
        "to_world" in props and not np.allclose(props["to_world"].matrix, translation_of(props))
    ):
        raise ConfigError("lens_camera: a shared camera has its own attitude; to_world may only translate it")
    return camera


@dataclass(frozen=True, slots=True)
class CameraMotion:
    """Attitudes of a camera over its exposure."""

    quaternion: np.ndarray  # (m, 4) Cam from world at equal steps, scalar last, neighbours on the same side
    duration_s: float  # Length of the table
    line_time_s: float  # Delay of a row after its neighbour
    first_row: int  # Row of the detector that is row 0 of the film


def motion_of(props: Any) -> CameraMotion | None:
    """The table of attitudes; None without."""
    if "motion_rotation" not in props:
        return None
    table = np.array(props["motion_rotation"], dtype=float)
    table = table[0] if table.ndim == 4 else table
    duration_s, line_time_s = float(props.get("motion_duration_s", 0.0)), float(props.get("line_time_s", 0.0))
    if table.ndim != 3 or table.shape[1:] != (3, 3) or len(table) < 2:
        raise ConfigError(f"lens_camera: motion_rotation has shape {table.shape}; (m, 3, 3) with m >= 2 is needed")
    if not duration_s > 0 or not 0 <= line_time_s < math.inf:
        raise ConfigError(
            f"lens_camera: motion_duration_s = {duration_s:g} s must be positive, line_time_s = {line_time_s:g} s not "
            "negative"
        )
    quaternion = Rotation.from_matrix(table).as_quat()
    sign = np.cumprod(np.where(np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]) < 0, -1.0, 1.0))
    quaternion[1:] *= sign[:, None]
    return CameraMotion(quaternion, duration_s, line_time_s, int(props.get("first_row", 0)))


def translation_of(props: Any) -> np.ndarray:
    """Matrix (4, 4) of the translation of ``to_world`` alone."""
    matrix = np.eye(4)
    if "to_world" in props:
        matrix[:3, 3] = np.array(props["to_world"].matrix, dtype=float)[:3, 3]
    return matrix


def exposure_motion_of(props: Any, exposure_s: float) -> ExposureMotion | None:
    """The motion of star images, of a handle or a file; None without."""
    if "exposure_motion" not in props:
        return None
    motion = MOTIONS.named(str(props["exposure_motion"]))
    if not math.isclose(motion.exposure_s, exposure_s, rel_tol=1e-9):
        raise ConfigError(
            f"lens_camera: the shutter is open for {exposure_s:g} s, exposure_motion lasts {motion.exposure_s:g} s"
        )
    return motion


def camera_of(props: Any, width: int, height: int) -> Camera:
    """The camera of a handle or a file, or the one that the properties describe, for a film of given pixels."""
    if "camera" in props:
        return _shared_camera(props, width, height)
    for name in ("lens", "pixel_pitch_um"):
        if name not in props:
            raise ConfigError(f"lens_camera: property {name!r} is missing")
    pitch_um = float(props["pixel_pitch_um"])
    if not pitch_um > 0:
        raise ConfigError(f"lens_camera: pixel_pitch_um = {pitch_um:g} um; it must be positive")
    return Camera(
        lens=load_lens(str(props["lens"])),
        width_px=width,
        height_px=height,
        pixel_pitch_mm=pitch_um * UM_MM,
        defocus_mm=float(props.get("defocus_mm", 0.0)),
        charge_diffusion_px=float(props.get("charge_diffusion_um", 0.0)) / pitch_um,
        diffraction=props.get("diffraction", "waves"),
        rotation_cam_from_world=_rotation(props),
    )
