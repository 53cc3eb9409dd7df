"""Numbers of a camera as scene parameters of ``lens_camera`` (``mi.traverse``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.parameters import lens_parameters, steps_of, with_parameters
from render.camera import Camera
from render.engine.jit import dr
from render.motion.trajectory import ConstantRate
from render.tracing.motion.exposure import ExposureMotion, exposure_motion

ALUMINIUM_PER_K = 23.6e-6
"""Expansion of aluminium 6061."""
FOCUS_STEP_MM = 1e-3
TURN_STEP_RAD = 1e-3
BESIDE_K = 1e-7
LINEAR = 1e-9
"""Part of the change of numbers by which they may bend and be taken to be linear."""
_WEIGHTS = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))
"""Fourth-order central difference."""


class CameraParameters:
    """Tensors of a camera: ``rotation``, ``attitude_rad``, ``rate_rad_per_s``, ``defocus_mm``, and the lens's own.

    The last are what `optics.lens.parameters.lens_parameters` names.
    """

    def __init__(self, mi: Any, camera: Camera, housing_cte_per_k: float) -> None:
        self.base, self.housing_cte_per_k = camera, housing_cte_per_k
        self._start = {**lens_parameters(camera.lens), "defocus_mm": np.array([camera.defocus_mm])}
        attitude = {"rotation": camera.rotation_cam_from_world, "attitude_rad": np.zeros(3)}
        arrays = attitude | {"rate_rad_per_s": np.zeros(3)} | self._start
        self.tensors = {name: mi.TensorXf64(np.ascontiguousarray(value)) for name, value in arrays.items()}
        self._known, self._optics = self._start, camera

    def values(self) -> dict[str, FloatArray]:
        """Present numbers of lens and focus."""
        return {name: plain(self.tensors[name], like.shape) for name, like in self._start.items()}

    def optics(self) -> Camera:
        """The camera with these numbers, but with its first attitude; the same record while they stay the same."""
        values = self.values()
        if any(not np.array_equal(values[name], known) for name, known in self._known.items()):
            self._optics, self._known = self.made(values), values
        return self._optics

    def made(self, values: dict[str, FloatArray]) -> Camera:
        """Camera of other numbers."""
        if all(np.array_equal(values[name], first) for name, first in self._start.items()):
            return self.base
        lens = with_parameters(
            self.base.lens,
            {name: value for name, value in values.items() if name != "defocus_mm"},
            housing_cte_per_k=self.housing_cte_per_k,
        )
        return replace(self.base, lens=lens, defocus_mm=float(values["defocus_mm"][0]))

    def rotation(self) -> FloatArray:
        """Cam from world (3, 3), with the turn on top."""
        rotation, turn = plain(self.tensors["rotation"], (3, 3)), plain(self.tensors["attitude_rad"], (3,))
        return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ rotation) if turn.any() else rotation

    def motion(self, camera: Camera, exposure_s: float) -> ExposureMotion | None:
        """Motion at the camera's rate, around its attitude in the middle of the exposure; None at rest."""
        rate = plain(self.tensors["rate_rad_per_s"], (3,))
        if not rate.any():
            return None
        start = Rotation.from_rotvec(0.5 * exposure_s * rate) * Rotation.from_matrix(camera.rotation_cam_from_world)
        path = ConstantRate(initial=start, rate_rad_per_s=rate, end_s=exposure_s)
        return exposure_motion(path, start_s=0.0, exposure_s=exposure_s, camera=camera)

    def turning(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turns (t, 3, 3) at times from the middle of the exposure, and their derivatives by the rate (t, 3, 3, 3)."""
        rate = plain(self.tensors["rate_rad_per_s"], (3,))
        step = TURN_STEP_RAD / float(np.abs(time_s).max())

        def turns(rate: FloatArray) -> FloatArray:
            return np.asarray(Rotation.from_rotvec(-time_s[:, None] * rate).as_matrix())

        columns = [sum(weight * turns(rate + times * step * axis) for times, weight in _WEIGHTS) for axis in np.eye(3)]
        return turns(rate), np.stack(columns, axis=-1) / step

    def _centre(self) -> dict[str, FloatArray]:
        """Numbers about which derivatives are taken.

        Glasses have thermal terms only away from the temperature of their catalogue: where that is differentiated, all
        is done `BESIDE_K` beside it.
        """
        values = self.values()
        if dr.grad_enabled(self.tensors["temperature_c"]):
            values["temperature_c"] = values["temperature_c"] + BESIDE_K
        return values

    def derivatives(
        self, numbers_of: Callable[[Camera], FloatArray]
    ) -> tuple[Camera, list[tuple[str, int, FloatArray]]]:
        """Derivatives of a vector computed from a camera, by every number that needs them."""
        values = self._centre()
        steps = {**steps_of({k: v for k, v in values.items() if k != "defocus_mm"})}
        steps["defocus_mm"] = np.array([FOCUS_STEP_MM])
        centre, found = self.made(values), []
        known = numbers_of(centre)
        for name, value in values.items():
            if not dr.grad_enabled(self.tensors[name]):
                continue
            for at in np.ndindex(value.shape):

                def moved(times: int, name: str = name, value: FloatArray = value, at: Any = at) -> FloatArray:
                    other = value.copy()
                    other[at] += times * steps[name][at]
                    return numbers_of(self.made({**values, name: other}))

                try:
                    ahead, back = moved(1), moved(-1)
                except DomainError:
                    if self._free(values, name, at):
                        raise
                    continue
                total = 0.5 * (ahead - back)
                if np.abs(ahead + back - 2.0 * known).max() > LINEAR * np.abs(total).max():
                    near = {1: ahead, -1: back}
                    total = sum((w * (near[n] if n in near else moved(n)) for n, w in _WEIGHTS), np.zeros(len(known)))
                found.append((name, int(np.ravel_multi_index(at, value.shape)), total / steps[name][at]))
        return centre, found

    def _free(self, values: dict[str, FloatArray], name: str, at: tuple[int, ...]) -> bool:
        """Whether a surface has this number."""
        moved = values[name].copy()
        moved[at] += 1e-12 + abs(moved[at]) * 1e-9
        try:
            self.made({**values, name: moved})
        except DomainError:
            return False
        return True

    def turn_derivatives(self) -> FloatArray:
        """Derivative (3, 3, 3) of the turn's matrix with respect to ``attitude_rad``, last axis."""
        turn = plain(self.tensors["attitude_rad"], (3,))
        columns = []
        for axis in np.eye(3):
            moved = (
                weight * Rotation.from_rotvec(turn + times * TURN_STEP_RAD * axis).as_matrix()
                for times, weight in _WEIGHTS
            )
            columns.append(sum(moved, np.zeros((3, 3))) / TURN_STEP_RAD)
        return np.stack(columns, axis=-1)


def plain(tensor: Any, shape: tuple[int, ...]) -> FloatArray:
    """Numbers of a tensor, without derivatives."""
    return np.array(dr.detach(tensor).numpy(), float).reshape(shape)
