"""Scene parameters of ``lens_camera`` (``mi.traverse``), and derivatives of the compiled lens by them."""

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
OFFSET_K = 1e-7
LINEAR = 1e-9
"""Second difference, over the first, below which a function counts as linear."""
_WEIGHTS = ((-2, 1.0 / 12.0), (-1, -2.0 / 3.0), (1, 2.0 / 3.0), (2, -1.0 / 12.0))
"""Fourth-order central difference."""


class CameraParameters:
    """Tensors of a camera: ``rotation``, ``attitude_rad``, ``rate_rad_per_s``, ``defocus_mm``, `lens_parameters`."""

    def __init__(self, mi: Any, camera: Camera, housing_cte_per_k: float) -> None:
        self.base, self.housing_cte_per_k = camera, housing_cte_per_k
        self._start = {**lens_parameters(camera.lens), "defocus_mm": np.array([camera.defocus_mm])}
        attitude = {"rotation": camera.rotation_cam_from_world, "attitude_rad": np.zeros(3)}
        arrays = attitude | {"rate_rad_per_s": np.zeros(3)} | self._start
        self.tensors = {name: mi.TensorXf64(np.ascontiguousarray(value)) for name, value in arrays.items()}
        self._values, self._optics = self._start, camera

    def values(self) -> dict[str, FloatArray]:
        """Present values of lens and focus."""
        return {name: plain(self.tensors[name], like.shape) for name, like in self._start.items()}

    def optics(self) -> Camera:
        """The camera of the present numbers in its first attitude; the same record while they stay the same."""
        values = self.values()
        if any(not np.array_equal(values[name], last) for name, last in self._values.items()):
            self._optics, self._values = self.camera_of(values), values
        return self._optics

    def camera_of(self, values: dict[str, FloatArray]) -> Camera:
        """Camera of some numbers, in its first attitude."""
        if all(np.array_equal(values[name], start) for name, start in self._start.items()):
            return self.base
        of_lens = {name: value for name, value in values.items() if name != "defocus_mm"}
        lens = with_parameters(self.base.lens, of_lens, housing_cte_per_k=self.housing_cte_per_k)
        return replace(self.base, lens=lens, defocus_mm=float(values["defocus_mm"][0]))

    def rotation(self) -> FloatArray:
        """Cam from world (3, 3): ``attitude_rad`` on top of ``rotation``."""
        rotation, attitude = plain(self.tensors["rotation"], (3, 3)), plain(self.tensors["attitude_rad"], (3,))
        return np.asarray(Rotation.from_rotvec(attitude).as_matrix() @ rotation) if attitude.any() else rotation

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

        return turns(rate), _derivatives(turns, rate, step)

    def derivatives(
        self, numbers_of: Callable[[Camera], FloatArray]
    ) -> tuple[Camera, list[tuple[str, int, FloatArray]]]:
        """Derivatives of a vector computed from a camera, by every number whose gradient is enabled.

        Glasses have thermal terms only away from the temperature of their catalogue: derivatives with respect to it are
        taken `OFFSET_K` away.
        """
        values = self.values()
        if dr.grad_enabled(self.tensors["temperature_c"]):
            values["temperature_c"] = values["temperature_c"] + OFFSET_K
        steps = dict(steps_of({name: value for name, value in values.items() if name != "defocus_mm"}))
        steps["defocus_mm"] = np.array([FOCUS_STEP_MM])
        centre, slopes = self.camera_of(values), []
        numbers = numbers_of(centre)
        for name, value in values.items():
            if not dr.grad_enabled(self.tensors[name]):
                continue
            for at in np.ndindex(value.shape):

                def moved(times: int, name: str = name, value: FloatArray = value, at: Any = at) -> FloatArray:
                    other = value.copy()
                    other[at] += times * steps[name][at]
                    return numbers_of(self.camera_of({**values, name: other}))

                try:
                    ahead, behind = moved(1), moved(-1)
                except DomainError:
                    if self._free(values, name, at):
                        raise
                    continue
                change = 0.5 * (ahead - behind)
                if np.abs(ahead + behind - 2.0 * numbers).max() > LINEAR * np.abs(change).max():
                    parts = (w * {1: ahead, -1: behind}[n] if abs(n) == 1 else w * moved(n) for n, w in _WEIGHTS)
                    change = sum(parts, np.zeros(len(numbers)))
                slopes.append((name, int(np.ravel_multi_index(at, value.shape)), change / steps[name][at]))
        return centre, slopes

    def _free(self, values: dict[str, FloatArray], name: str, at: tuple[int, ...]) -> bool:
        """Whether a surface has this number."""
        moved = values[name].copy()
        moved[at] += 1e-12 + abs(moved[at]) * 1e-9
        try:
            self.camera_of({**values, name: moved})
        except DomainError:
            return False
        return True

    def turn_derivatives(self) -> FloatArray:
        """Derivative (3, 3, 3) of the turn's matrix with respect to ``attitude_rad``, last axis."""
        attitude = plain(self.tensors["attitude_rad"], (3,))
        return _derivatives(lambda v: Rotation.from_rotvec(v).as_matrix(), attitude, TURN_STEP_RAD)


def _derivatives(function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float) -> FloatArray:
    """Fourth-order central differences of a function of a vector, one for each component (last axis)."""
    columns = [sum(weight * function(at + times * step * axis) for times, weight in _WEIGHTS) for axis in np.eye(3)]
    return np.stack(columns, axis=-1) / step


def plain(tensor: Any, shape: tuple[int, ...]) -> FloatArray:
    """Numbers of a tensor, without derivatives."""
    return np.array(dr.detach(tensor).numpy(), float).reshape(shape)
