"""What is true of the bodies that a frame shows as disks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from experiments.dataset.frames.plan import FramePlan
from experiments.dataset.frames.scene import Scene
from experiments.dataset.frames.sky_light import PLANET_IDS, Disk
from experiments.dataset.truth.frame_record import DiskTruth
from experiments.dataset.truth.labels import pixel_of
from optics.units import ARCSEC_RAD

__all__ = ["disk_truth"]


def disk_truth(scene: Scene, plan: FramePlan, disks: Sequence[Disk]) -> tuple[DiskTruth, ...]:
    """Truth of those disks of a frame whose light reaches the detector."""
    system = scene.sky_light.disks
    lit = [disk for disk in disks if disk.image.electrons[0] > 0.0]
    if system is None or not lit:
        return ()
    rows = [disk.row for disk in lit]
    turn = plan.attitude.as_matrix()
    v_cam, to_sun = system.direction[rows] @ turn.T, system.to_sun_au[rows] @ turn.T
    ra, dec = np.degrees(np.arctan2(*system.direction[rows].T[1::-1])) % 360.0, np.arcsin(system.direction[rows, 2])
    found = []
    for k, (disk, (x, y)) in enumerate(zip(lit, pixel_of(scene, v_cam), strict=True)):
        across = to_sun[k] - v_cam[k] * (to_sun[k] @ v_cam[k])
        magnitude = float(system.magnitude_v[disk.row])
        found.append(
            DiskTruth(
                name=disk.name,
                kind="moon" if disk.name == "moon" else "planet",
                star_id=PLANET_IDS[disk.name],
                ra_deg=float(ra[k]),
                dec_deg=float(np.degrees(dec[k])),
                x_px=float(x),
                y_px=float(y),
                diameter_px=float(system.angular_diameter_rad[disk.row] / (scene.instrument.pixel_arcsec * ARCSEC_RAD)),
                phase_deg=float(np.degrees(system.phase_rad[disk.row])),
                sun_angle_deg=math.degrees(math.atan2(across[1], across[0])),
                magnitude=None if math.isnan(magnitude) else magnitude,
                electrons=float(disk.image.electrons[0]),
                photon_x_px=float(disk.image.photon_px[0, 0]),
                photon_y_px=float(disk.image.photon_px[0, 1]),
                noise_share=disk.image.noise_share,
            )
        )
    return tuple(found)
