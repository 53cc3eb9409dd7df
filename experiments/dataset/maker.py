"""One frame with its truth: a pure function of configuration and frame number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.plan import FramePlan, plan_frame
from experiments.dataset.scene import Scene, stars_of
from experiments.dataset.truth import FLAGS, StarLightOnChip, pixel_flags, star_rows
from render.random import Streams
from render.readout import expose
from render.records import Frame, StarField
from render.sky_field import SkyField
from render.tracer import Tracer

__all__ = ["FrameMaker", "MadeFrame"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeFrame:
    """A frame as it will be written.

    Attributes
    ----------
    plan : FramePlan
        Attitude, motion, split.
    frame : Frame
        Digital numbers.
    truth : dict
        Columns of the truth (`experiments.dataset.truth.COLUMNS`).
    background_e : float
        Mean expected electrons per pixel of sky light.
    saturated_px : int
        Pixels that are saturated.
    """

    plan: FramePlan
    frame: Frame
    truth: dict[str, Any]
    background_e: float
    saturated_px: int

    @property
    def stars(self) -> int:
        """Stars of which light reaches the detector."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["no_light"][0] == 0))

    @property
    def saturated(self) -> int:
        """Stars with a saturated pixel."""
        return int(np.count_nonzero(self.truth["flags"] & FLAGS["saturated"][0]))


class FrameMaker:
    """Makes frames of one dataset; what it makes depends on the scene and the frame number alone.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    scene : Scene
        What the frames have in common.
    """

    def __init__(self, mi: Any, scene: Scene) -> None:
        self.scene = scene
        self.backend = str(mi.variant()).split("_", maxsplit=1)[0]
        self._tracer = Tracer(mi, scene.instrument.camera)
        self._streams: Streams = scene.plan.streams.child("detector")

    def make(self, frame: int) -> MadeFrame:
        """Frame number ``frame``, 0 to 2^32 - 1."""
        scene, config = self.scene, self.scene.config
        plan = plan_frame(scene.plan, frame)
        field = stars_of(scene, frame)
        traced = self._tracer.render(
            self._star_field(field),
            exposure_s=config.camera.exposure_s,
            rotation_cam_from_world=field.rotation_cam_from_icrs,
        )
        band = scene.light.band[0]
        sky_e_per_s = config.background.extra_e_per_s
        read = expose(
            traced.electrons[:, :, 0],
            scene.instrument.detector,
            streams=self._streams,
            frame=frame,
            exposure_s=config.camera.exposure_s,
            temperature_c=config.camera.chip_temperature_c,
            background_e_per_s=sky_e_per_s,
            band=band,
            backend=self.backend,
        )
        background_e = sky_e_per_s * config.camera.exposure_s
        truth = star_rows(
            field,
            traced.truth,
            scene.instrument.detector,
            frame=frame,
            band=band,
            catalogue_row=scene.row[field.row],
            temperature_k=scene.temperature_k[field.row],
            on_chip=StarLightOnChip(
                background_e=background_e + self._dark_e(),
                pixel_flags=pixel_flags(read.saturated, read.defect),
                smear_px=np.zeros((len(field), 2)),
            ),
        )
        return MadeFrame(
            plan=plan,
            frame=read,
            truth=truth,
            background_e=background_e,
            saturated_px=int(np.count_nonzero(read.saturated)),
        )

    def _star_field(self, field: SkyField) -> StarField:
        light = self.scene.light
        return StarField(
            direction=field.direction,
            wavelength_nm=light.wavelength_nm,
            photon_rate=light.photon_rate(field.stars.magnitude, self.scene.temperature_k[field.row]),
            band=light.band,
        )

    def _dark_e(self) -> float:
        """Mean dark charge of a normal pixel [e-]."""
        camera, detector = self.scene.config.camera, self.scene.instrument.detector
        return detector.dark_current_e_per_s * detector.dark_factor(camera.chip_temperature_c) * camera.exposure_s
