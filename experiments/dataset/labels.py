"""Objects of a frame other than stars: disks of the Moon and the planets, hot pixels, tracks of cosmic rays.

Stars and planets smaller than a pixel are point sources: labelled from the rows of the truth (`exports`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.plan import FramePlan, plan_frame
from experiments.dataset.scene import PLANET_IDS, DatasetScene
from experiments.dataset.truth import DiskTruth
from optics.frames import equatorial_deg
from optics.units import ARCSEC_RAD
from render.detector.cosmic_ray_clusters import charge_clusters
from render.detector.maps import sensor_maps
from render.observation import BodyDisk

IntArray = NDArray[np.int64]

Class = Literal["star", "planet", "moon", "hot_pixel", "cosmic_ray"]
CLASSES: dict[str, str] = {
    "star": "star of the catalogue",
    "planet": "planet of the solar system, as a point or a disk",
    "moon": "the Earth's Moon, as a disk",
    "hot_pixel": "a pixel that the detector's map calls defective and whose dark charge exceeds five times its noise",
    "cosmic_ray": "neighbouring pixels in which cosmic rays left at least an electron each",
}
HOT_SIGMA = 5.0
"""Dark charge of a hot pixel, in standard deviations of the temporal noise of a dark pixel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """An object in a frame."""

    kind: Class  # One of `CLASSES`
    name: str = ""  # Name of a body of the solar system
    x_px: float  # Column of the centre, 0 at the centre of the first pixel
    y_px: float  # Row of the centre
    box_px: tuple[float, float, float, float]  # Left, top, width, height, from the outer corner of the first pixel
    pixels: IntArray  # (2, n) Rows and columns of the object's pixels
    electrons: float = float("nan")  # Mean dark charge of a hot pixel, charge of a track; NaN for a body


def pixels_of_ellipse(x: float, y: float, half_x: float, half_y: float, shape: tuple[int, int]) -> IntArray:
    """Rows and columns (2, n) of the pixels of an image whose centres lie in an upright ellipse."""
    first_row, last_row = max(0, math.ceil(y - half_y)), min(shape[0] - 1, math.floor(y + half_y))
    first, last = max(0, math.ceil(x - half_x)), min(shape[1] - 1, math.floor(x + half_x))
    rows, columns = np.mgrid[first_row : last_row + 1, first : last + 1]
    inside = ((columns - x) / half_x) ** 2 + ((rows - y) / half_y) ** 2 <= 1.0
    return np.stack([rows[inside], columns[inside]])


class FrameLabeller:
    """Labels of the frames of one dataset."""

    def __init__(self, scene: DatasetScene) -> None:
        self.scene = scene
        self._hot = self._hot_pixels()

    def labels(self, frame: int) -> list[Label]:
        """Labels of a frame without its stars and point-like planets, which have rows in its truth."""
        hits = self.scene.simulator.hits(frame)
        labels = [*body_labels(self.scene, plan_frame(self.scene.plan, frame)), *self._hot]
        for cluster in [] if hits is None else charge_clusters(hits):
            left, top, width, height = map(float, cluster.box_px)
            labels.append(
                Label(
                    kind="cosmic_ray",
                    x_px=cluster.x_px,
                    y_px=cluster.y_px,
                    box_px=(left, top, width, height),
                    pixels=cluster.pixels,
                    electrons=cluster.charge_e,
                )
            )
        return labels

    def _hot_pixels(self) -> list[Label]:
        instrument = self.scene.instrument
        detector, config = instrument.detector, self.scene.config.instrument
        maps = sensor_maps(detector)
        dark_e = maps.dark_current_e_per_s * (detector.dark_factor(config.chip_temperature_c) * config.exposure_s)
        noise_e = np.sqrt(instrument.pixel_noise(detector).temporal_e2(0.0))
        rows, columns = np.nonzero(maps.defect & (dark_e > HOT_SIGMA * noise_e))
        return [
            Label(
                kind="hot_pixel",
                x_px=float(x),
                y_px=float(y),
                box_px=(float(x), float(y), 1.0, 1.0),
                pixels=np.array([[y], [x]]),
                electrons=float(dark_e[y, x]),
            )
            for x, y in zip(columns.tolist(), rows.tolist(), strict=True)
        ]


def body_labels(scene: DatasetScene, plan: FramePlan) -> list[Label]:
    """Labels of the disks in a frame."""
    disks = scene.simulator.disks
    if disks is None or not len(disks):
        return []
    camera = scene.instrument.camera
    direction_cam = disks.direction @ plan.attitude.as_matrix().T
    in_front = np.flatnonzero(direction_cam[:, 2] > 0.0)
    centre_px = scene.simulator.pixel_px(direction_cam[in_front]).tolist()
    radius_px = 0.5 * disks.angular_diameter_rad[in_front] / (scene.instrument.pixel_arcsec * ARCSEC_RAD)
    labels = []
    for name, (x, y), r in zip(np.asarray(disks.name)[in_front].tolist(), centre_px, radius_px.tolist(), strict=True):
        left, right = np.clip([x + 0.5 - r, x + 0.5 + r], 0.0, camera.width_px).tolist()
        top, bottom = np.clip([y + 0.5 - r, y + 0.5 + r], 0.0, camera.height_px).tolist()
        if right > left and bottom > top:  # not for NaN
            box_px = left, top, right - left, bottom - top
            kind: Class = "moon" if name == "moon" else "planet"
            pixels = pixels_of_ellipse(x, y, r, r, (camera.height_px, camera.width_px))
            labels.append(Label(kind=kind, name=name, x_px=x, y_px=y, box_px=box_px, pixels=pixels))
    return labels


def disk_truth(scene: DatasetScene, plan: FramePlan, disks: Sequence[BodyDisk]) -> tuple[DiskTruth, ...]:
    """Truth of the disks of a frame with light on the detector."""
    illuminated = [disk for disk in disks if disk.image.electrons[0] > 0.0]
    if scene.simulator.disks is None or not illuminated:
        return ()
    bodies = scene.simulator.disks.select([disk.row for disk in illuminated])
    rotation = plan.attitude.as_matrix()
    centre_px = scene.simulator.pixel_px(bodies.direction @ rotation.T)
    ra_deg, dec_deg = equatorial_deg(bodies.direction)
    sun_angle_deg = np.degrees(bodies.sun_angle_rad(rotation))
    pixel_rad = scene.instrument.pixel_arcsec * ARCSEC_RAD
    truths = []
    for k, (disk, (x, y)) in enumerate(zip(illuminated, centre_px, strict=True)):
        magnitude = float(bodies.magnitude_v[k])
        truths.append(
            DiskTruth(
                name=disk.name,
                kind="moon" if disk.name == "moon" else "planet",
                star_id=PLANET_IDS[disk.name],
                ra_deg=float(ra_deg[k]),
                dec_deg=float(dec_deg[k]),
                x_px=float(x),
                y_px=float(y),
                diameter_px=float(bodies.angular_diameter_rad[k] / pixel_rad),
                phase_deg=float(np.degrees(bodies.phase_rad[k])),
                sun_angle_deg=float(sun_angle_deg[k]),
                magnitude=None if math.isnan(magnitude) else magnitude,
                electrons=float(disk.image.electrons[0]),
                photon_x_px=float(disk.image.photon_px[0, 0]),
                photon_y_px=float(disk.image.photon_px[0, 1]),
                noise_share=disk.image.noise_share,
            )
        )
    return tuple(truths)
