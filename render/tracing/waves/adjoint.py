"""Sums of plane waves over windows, and their derivatives in closed form.

With P the phase at the middle of the samples [turns], A the amplitude and E the light of a wavelength,

    U(X) = sum_j sqrt(pi) A_j exp{2 pi i [P_j + f_j X]},   I = sum E |U|^2,   dI = sum 2 E Re{conj(U) dU} + |U|^2 dE

so that the adjoint of a weight G over the samples is one more sum, of G conj(U) over the window, for every ray.
Both sums are non-uniform Fourier transforms in double precision, by FINUFFT (Barnett, Magland & af Klinteberg 2019,
SIAM J. Sci. Comput. 41, C479).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import finufft
import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.tracing.waves.pixel_kernel import BandLimited, FieldSampling, window_samples

SETTINGS: dict[str, Any] = {"eps": 1e-9, "nthreads": 1}
ComplexArray = NDArray[np.complex128]
ARRAYS = ("phase", "fx", "fy", "amplitude", "energy", "right", "down", "part")  # of `_Stamps`


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Window of the image of one star in one band, and conversion of samples to pixels."""

    corner_px: FloatArray  # (2,) Outer corner (column, row) of the window
    mean_px: FloatArray  # (2,) Centre of the samples
    size: int  # Pixels of the window along an axis
    field: FieldSampling
    sigma_px: float  # Charge diffusion
    first_px: FloatArray  # (2,) Whole pixels from the window to the stamp
    stamp_px: int  # Pixels of the stamp along an axis
    moving: bool  # Whether the image is a trail: its disk is one of samples then, of pixels otherwise

    @property
    def kernel(self) -> BandLimited:
        """Kernel of a pixel."""
        return self.field.pixel(1.0, self.sigma_px)

    @property
    def samples(self) -> FloatArray:
        """Samples along an axis, from the mean."""
        return window_samples(self.field, float(self.size), self.kernel.reach_px) - 0.5 * self.size

    @property
    def places(self) -> FloatArray:
        """The same (2, samples) along columns and rows, from the middle of the window."""
        return self.samples + (self.mean_px - self.corner_px - 0.5 * self.size)[:, None]

    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Masks of the samples and of the pixels within the rendered disk."""
        (column, row), pixels = self.places, np.arange(0.5, self.size) - 0.5 * self.size
        if self.moving:
            return np.asarray(np.hypot(column, row[:, None]) <= 0.5 * self.size, np.float64), np.ones((1, 1))
        return np.ones((1, 1)), np.asarray(np.hypot(pixels, pixels[:, None]) <= 0.5 * (self.size - 1), np.float64)

    def matrices(self, offset_px: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
        """Matrices (t, m, samples) from samples of an image moved by offsets (t,) to pixels, and their derivatives."""
        centres = np.arange(self.stamp_px) + 0.5 + self.first_px[axis] - 0.5 * self.size
        distance = centres[:, None] - self.places[axis] - offset_px[:, None, None]
        kernel, step = self.kernel, self.field.light_step
        return kernel(distance) * step, -kernel.slope(distance) * step


class _WindowSum:
    """Waves of one star, band and wavelength over the samples of a window; frequencies count from a middle one."""

    def __init__(
        self, phase: FloatArray, fx: FloatArray, fy: FloatArray, amplitude: FloatArray, samples: FloatArray
    ) -> None:
        fx, fy = (f - 0.5 * (f.max() + f.min()) for f in (fx, fy))
        step = 2.0 * np.pi * float(samples[1] - samples[0])
        self.points = step * fy, step * fx  # [rad per sample]: rows first
        self.samples, self.amplitude = samples, amplitude
        # samples lie about 0; FINUFFT counts them from -(n // 2)
        about = 0.5 * (len(samples) - 1) - len(samples) // 2
        self.phase = np.sqrt(np.pi) * np.exp(2j * np.pi * phase - 1j * about * (self.points[0] + self.points[1]))

    def _sums(self, *coefficients: ComplexArray) -> ComplexArray:
        """Sums (c, rows, columns) of waves with c coefficients (p,)."""
        shape = len(self.samples), len(self.samples)
        return np.asarray(finufft.nufft2d1(*self.points, np.stack(coefficients), shape, isign=1, **SETTINGS))

    def field(self) -> ComplexArray:
        """U (rows, columns), but for a wave of the middle frequency."""
        return self._sums(self.phase * self.amplitude).reshape(len(self.samples), -1)

    def change(self, phase: FloatArray, fx: FloatArray, fy: FloatArray, amplitude: FloatArray) -> ComplexArray:
        """Change of U with changes of the rays."""
        turned = 2j * np.pi * self.amplitude * self.phase
        parts = self._sums(turned * phase + self.phase * amplitude, turned * fx, turned * fy)
        return np.asarray(parts[0] + parts[1] * self.samples + parts[2] * self.samples[:, None])

    def adjoint(self, weight: ComplexArray) -> tuple[FloatArray, ...]:
        """Gradients of Re sum(weight U) with respect to phase, fx, fy and amplitude."""
        weights = np.stack([weight, weight * self.samples, weight * self.samples[:, None]])
        total, along, across = finufft.nufft2d2(*self.points, weights, isign=1, **SETTINGS) * self.phase
        by_phase = -2.0 * np.pi * self.amplitude
        return by_phase * total.imag, by_phase * along.imag, by_phase * across.imag, total.real


@dataclass(frozen=True, slots=True)
class WaveLanes:
    """Plane waves as arrays with derivatives, of s b windows at k wavelengths, p of each; lanes (s b k p,)."""

    phase: Any  # At the mean that samples lie about [turns]
    fx: Any  # Spatial frequencies along columns [cycles/px]
    fy: Any  # Along rows
    amplitude: Any  # As in `render.tracing.waves.plane_waves.PlaneWaves`


def summed_waves(
    F: Any,
    windows: list[Window],
    lanes: WaveLanes,
    energy: Any,
    offset: tuple[Any, Any],
    weight: Any,
    *,
    values: bool = True,
) -> Any:
    """Electrons of the pixels of stamps (s b m m,), with derivatives; without ``values`` these alone, and zeros."""
    # energy (s b k,) [e-], offset (s b t,) [px], weight (s b t,)

    class Sum(dr.CustomOp):
        """The sum; arrays as in `_Stamps`."""

        def eval(
            self, phase: Any, fx: Any, fy: Any, amplitude: Any, energy: Any, right: Any, down: Any, part: Any
        ) -> Any:
            arrays = (phase, fx, fy, amplitude, energy, right, down, part)
            self.stamps = _Stamps(windows, [np.array(a.numpy()) for a in arrays])
            if not values:
                return dr.zeros(F, sum(window.stamp_px**2 for window in windows))
            return uploaded(F, self.stamps.pixels())

        def forward(self) -> None:
            arrays: list[Any] = [self.grad_in(name) for name in ARRAYS]
            changes = [np.array(a.numpy()) for a in arrays]
            self.set_grad_out(uploaded(F, self.stamps.changed(changes)))

        def backward(self) -> None:
            gradient_out: Any = self.grad_out()
            gradients = self.stamps.adjoint(np.array(gradient_out.numpy()))
            for name, gradient in zip(ARRAYS, gradients, strict=True):
                self.set_grad_in(name, uploaded(F, gradient))

        def name(self) -> str:
            return "sum of plane waves"

    return dr.custom(Sum, lanes.phase, lanes.fx, lanes.fy, lanes.amplitude, energy, *offset, weight)


class _Stamps:
    """Stamps of windows, on NumPy.

    Arrays: phase, fx, fy and amplitude of rays; light of wavelengths; offsets along columns and rows, and parts of
    times.
    """

    def __init__(self, windows: list[Window], arrays: list[FloatArray]) -> None:
        self.windows, count = windows, len(windows)
        self.colours = arrays[4].size // count
        self.rays = [a.reshape(count, self.colours, -1) for a in arrays[:4]]
        self.energy, *self.moves = (a.reshape(count, -1) for a in arrays[4:])

    def _fields(self, slot: int) -> Iterator[tuple[int, _WindowSum, NDArray[np.complex128]]]:
        samples = self.windows[slot].samples
        for k in range(self.colours):
            phase, fx, fy, amplitude = (a[slot, k] for a in self.rays)
            rays = _WindowSum(phase, fx, fy, amplitude, samples)
            yield k, rays, rays.field()

    def _light(self, slot: int) -> FloatArray:
        return np.asarray(sum(self.energy[slot, k] * np.abs(u) ** 2 for k, _, u in self._fields(slot)))

    def _matrices(self, slot: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        window, (ox, oy, weight) = self.windows[slot], (m[slot] for m in self.moves)
        return *window.matrices(ox, 0), *window.matrices(oy, 1), weight

    def pixels(self) -> FloatArray:
        """Pixels (slots, m, m)."""
        stamps = []
        for slot, window in enumerate(self.windows):
            column, _, row, _, weight = self._matrices(slot)
            inside, disk = window.ends()
            image = self._light(slot) * inside
            stamps.append(np.einsum("t,tij->ij", weight, row @ image @ np.swapaxes(column, 1, 2)) * disk)
        return np.stack(stamps)

    def changed(self, changes: list[FloatArray]) -> FloatArray:
        """Change of the pixels with changes of the arrays."""
        count = len(self.windows)
        shapes = [a.shape for a in (*self.rays, self.energy, *self.moves)]
        *rays, energy, dx, dy, dw = (
            np.broadcast_to(c, math.prod(s)).reshape(s) for c, s in zip(changes, shapes, strict=True)
        )
        changed_stamps = []
        for slot in range(count):
            column, column_slope, row, row_slope, weight = self._matrices(slot)
            inside, disk = self.windows[slot].ends()
            light, slope = np.zeros(()), np.zeros(())
            for k, waves, u in self._fields(slot):
                du = waves.change(*(r[slot, k] for r in rays))
                light = light + self.energy[slot, k] * np.abs(u) ** 2
                slope = slope + energy[slot, k] * np.abs(u) ** 2 + 2.0 * self.energy[slot, k] * (u.conj() * du).real
            light, slope = light * inside, slope * inside
            c, c_slope = np.swapaxes(column, 1, 2), np.swapaxes(column_slope, 1, 2)
            w, x, y, v = (a[:, None, None] for a in (weight, weight * dx[slot], weight * dy[slot], dw[slot]))
            each = w * (row @ slope @ c) + v * (row @ light @ c)
            each = each + x * (row @ light @ c_slope) + y * (row_slope @ light @ c)
            changed_stamps.append(each.sum(0) * disk)
        return np.stack(changed_stamps)

    def adjoint(self, gradient: FloatArray) -> list[FloatArray]:
        """Gradients of all arrays from that of the pixels."""
        gradients = [np.zeros_like(a) for a in (*self.rays, self.energy, *self.moves)]
        for slot, window in enumerate(self.windows):
            column, column_slope, row, row_slope, weight = self._matrices(slot)
            inside, disk = window.ends()
            g = gradient.reshape(len(self.windows), window.stamp_px, window.stamp_px)[slot] * disk
            to_light = np.einsum("t,tij->ij", weight, np.swapaxes(row, 1, 2) @ g @ column) * inside
            light = np.zeros(())
            for k, waves, u in self._fields(slot):
                light = light + self.energy[slot, k] * np.abs(u) ** 2
                gradients[4][slot, k] = (to_light * np.abs(u) ** 2).sum()
                parts = waves.adjoint(2.0 * self.energy[slot, k] * to_light * u.conj())
                for into, part in zip(gradients[:4], parts, strict=True):
                    into[slot, k] = part
            light = light * inside
            c, c_slope = np.swapaxes(column, 1, 2), np.swapaxes(column_slope, 1, 2)
            gradients[5][slot] = weight * (g * (row @ light @ c_slope)).sum((1, 2))
            gradients[6][slot] = weight * (g * (row_slope @ light @ c)).sum((1, 2))
            gradients[7][slot] = (g * (row @ light @ c)).sum((1, 2))
        return gradients
