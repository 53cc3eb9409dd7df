r"""Transmission of every ray along its path, over that of the axis, as a polynomial in the launch disk.

The loss of a ray in surfaces and glasses (`optics.rays.ghosts.trace_ghost`: reflection at the angle of that ray,
absorption along its path, the mean of s and p light at each surface) is a smooth function of its direction and of the
point where it starts. It is traced once per wavelength, at a few fields and points of their beams, and fitted:

.. math:: g = \sum_{ij} c_{ij}(\mathrm{field}) \, q_1^i q_2^j, \qquad q = (p^2, p \cdot t) \text{ or } (p_x, p_y)

with p a point of the launch disk (of radius 1) and t the direction of the light across the axis over the largest one.
Lenses of revolution have the first pair and coefficients that are polynomials in t^2; others the second pair and
polynomials in both components of t. The kernel adds up ten to some thirty terms for a ray. The error of the fit is
measured at rays outside its data.
"""

from __future__ import annotations

import math
import pickle
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from optics.arrays import FloatArray, IntArray
from optics.frames import light_direction
from optics.rays.entrance_pupil import EntrancePupil, launch_disks
from optics.rays.ghosts import trace_ghost
from optics.rays.pupil_sampling import gauss_disk
from optics.rays.trace import OK, Rays
from render.camera import Camera

TOLERANCE = 2e-5
"""Largest error of a transmission at which no higher order is tried."""
ENOUGH = 1e-4
"""Error of a lens of revolution's fit at which no other is tried."""
RIDGE = 1e-14
"""Weight of the squared unknowns added to the squared errors."""
IMPROVED = 0.7
"""Ratio of the errors of an order and of the best so far above which no higher one is tried."""
FIELDS, TEST_FIELDS = 8, 4
"""Field angles of the fit, and those between at which its error is measured."""
SPREAD = ((0.0, 1), (0.35, 6), (0.65, 10), (0.9, 14), (1.0, 18))
TEST_SPREAD = ((0.5, 7), (0.8, 9), (0.97, 11))
"""The same of lenses that are none of revolution: parts of the reach, and azimuths."""
ROOM = 1.03
"""Reach of the fit in terms of the farthest corner of the detector; stars beyond have the transmission there."""
ORDERS = ((2, 3), (3, 5), (4, 6), (5, 8))
"""Degrees in the launch disk, and in all, that are tried for a lens of revolution."""
GENERAL_ORDERS = ((4, 6), (6, 8))
"""The same for other lenses."""
DISK, TEST_DISK = (5, 14), (3, 9)
"""Rings and azimuths of the beams' points."""
FLAT = 1e-9
"""Difference from 1 below which nothing is to be fitted."""
GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True, eq=False)
class PupilTransmission:
    """Transmission over that of the axis at b k wavelengths."""

    turned: bool  # Whether the lens is one of revolution
    reach: float  # Largest direction cosine across the axis
    power: IntArray  # (m, 2) Powers of the coordinates in the launch disk
    field_power: IntArray  # (m, 2) Powers of the direction's: of t^2, or of its components
    term: IntArray  # (m,) Which of the q pairs of powers in the launch disk each is
    pairs: IntArray  # (q, 2) These
    coefficient: FloatArray  # (b k, m)
    error: float  # Largest at rays outside the fit's data

    def table(self, light: FloatArray) -> FloatArray:
        """Coefficients (n, b k, q) of the pairs of powers for light of directions (n, 3)."""
        across = light[:, :2] / self.reach
        across = across / np.maximum(np.hypot(*across.T), 1.0)[:, None]
        basis = _field_terms(self.turned, across, self.field_power)
        coefficients = np.zeros((len(light), len(self.coefficient), len(self.pairs)))
        for q in range(len(self.pairs)):
            some = self.term == q
            coefficients[..., q] = basis[:, some] @ self.coefficient[:, some].T
        return coefficients

    def coordinates(self, px: Any, py: Any, dx: Any, dy: Any) -> tuple[Any, Any]:
        """Coordinates of points of the launch disk for light with direction cosines dx, dy across the axis."""
        if not self.turned:
            return px, py
        return px * px + py * py, (px * dx + py * dy) * (1.0 / self.reach)

    def value(self, table: Any, first: Any, second: Any) -> Any:
        """Sum of the terms (Horner in both coordinates) from the q coefficients of a ray."""
        by_pair = {(int(i), int(j)): table[q] for q, (i, j) in enumerate(self.pairs)}
        total: Any = None
        for i in range(int(self.pairs[:, 0].max()), -1, -1):
            row: Any = None
            for j in range(max(b for a, b in by_pair if a == i), -1, -1):
                row = by_pair[i, j] if row is None else row * second + by_pair[i, j]
            total = row if total is None else total * first + row
        return total


def _field_terms(turned: bool, across: FloatArray, power: IntArray) -> FloatArray:
    """Powers (n, m) of directions (n, 2)."""
    square = (across**2).sum(1)
    first, second = (square, np.ones_like(square)) if turned else (across[:, 0], across[:, 1])
    return np.asarray(first[:, None] ** power[:, 0] * second[:, None] ** power[:, 1])


def _powers(turned: bool, disk: int, total: int) -> tuple[IntArray, IntArray]:
    """Powers (m, 2) in the launch disk and of the field, up to degrees in the disk and in all."""
    rows = []
    for i in range(disk + 1):
        for j in range(disk + 1 - i):
            remaining = total - i - j
            rows += [(i, j, k, m) for k in range(remaining + 1) for m in range(1 if turned else remaining + 1 - k)]
    powers = np.array(rows)
    return powers[:, :2], powers[:, 2:]


@dataclass(frozen=True, slots=True)
class _Samples:
    """Rays through the lens: directions, points of the launch disk, and transmissions of w wavelengths."""

    light: FloatArray  # (f, 3)
    px: FloatArray  # (f, p)
    py: FloatArray  # (f, p)
    value: FloatArray  # (w, f, p) NaN where none gets through


def _fields(reach_rad: float, count: int, shift: float, spread: bool) -> FloatArray:
    """Unit vectors (f, 3) towards stars from the axis to a reach, at azimuths all around."""
    part = np.sin(0.5 * np.pi * (np.arange(count) + shift) / (count - 1 + 2.0 * shift))
    azimuth = GOLDEN * np.arange(count)
    if spread:  # over the disk of fields
        rings = SPREAD if shift == 0.0 else TEST_SPREAD
        part = np.concatenate([np.full(n, r) for r, n in rings])
        azimuth = np.concatenate([2.0 * np.pi * (np.arange(n) + shift) / n for _, n in rings])
    angle = reach_rad * part
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)


def fit_transmission(camera: Camera, pupil: EntrancePupil, wavelength_nm: FloatArray) -> PupilTransmission | None:
    """Fit for wavelengths (b, k); None where all rays have the axial loss, or the camera has no losses."""
    if camera.losses is None:
        return None
    key = pickle.dumps((camera.focused_lens, camera.losses, pupil, camera.field_reach_rad))
    return _fitted(_CameraKey(camera, pupil, key), wavelength_nm.tobytes())


class _CameraKey:
    """A camera, compared by what its transmission depends on."""

    def __init__(self, camera: Camera, pupil: EntrancePupil, key: bytes) -> None:
        self.camera, self.pupil, self.key = camera, pupil, key

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _CameraKey) and self.key == other.key


@lru_cache(maxsize=32)
def _fitted(key: _CameraKey, wavelengths: bytes) -> PupilTransmission | None:
    wave = np.unique(np.frombuffer(wavelengths))
    inverse = np.searchsorted(wave, np.frombuffer(wavelengths))
    fit = _Fit(key, wave).best()
    return None if fit is None else replace(fit, coefficient=fit.coefficient[inverse])


class _Fit:
    """Rays of a camera at some wavelengths."""

    def __init__(self, key: _CameraKey, wave: FloatArray) -> None:
        losses = key.camera.losses
        assert losses is not None
        self.lens, self.pupil, self.losses, self.wave = key.camera.focused_lens, key.pupil, losses, wave
        self.reach_rad = min(ROOM * key.camera.field_reach_rad, 1.5)
        self.on_axis = losses.along_axis(self.lens, wave)

    def best(self) -> PupilTransmission | None:
        """The lowest order that is good enough, or the best."""
        fitted, test = self._samples(False)
        lit = [samples.value[np.isfinite(samples.value)] for samples in (fitted, test)]
        if not all(map(len, lit)) or max(float(np.abs(v - 1.0).max()) for v in lit) < FLAT:
            return None
        best: PupilTransmission | None = None
        for turned, orders in ((True, ORDERS), (False, GENERAL_ORDERS)):
            if not turned:
                fitted, test = self._samples(True)
            for disk, total in orders:
                candidate = _fit(turned, disk, total, math.sin(self.reach_rad), fitted, test)
                improved = best is None or candidate.error < IMPROVED * best.error
                best = candidate if best is None or candidate.error < best.error else best
                if best.error < TOLERANCE:
                    return best
                if not improved:
                    break
            if best is not None and best.error < ENOUGH:
                break
        return best

    def _samples(self, spread: bool) -> tuple[_Samples, _Samples]:
        fitted = self._traced(_fields(self.reach_rad, FIELDS, 0.0, spread), DISK)
        return fitted, self._traced(_fields(self.reach_rad, TEST_FIELDS, 0.4, spread), TEST_DISK)

    def _traced(self, stars: FloatArray, order: tuple[int, int]) -> _Samples:
        lens, disk, points, light = self.lens, self.pupil, gauss_disk(*order), light_direction(stars)
        unit = disk.radius_mm
        if disk.exact:
            px, py = (np.broadcast_to(v, (len(stars), len(points.x))) for v in (points.x, points.y))
        else:
            disks = launch_disks(lens, stars, self.wave)
            down = (disk.z_mm - float(disks.z_mm)) * light[:, :2] / light[:, 2:]
            radius, cx, cy = (v.reshape(-1, 1) for v in (disks.radius_mm, disks.x_mm, disks.y_mm))
            px = (cx + down[:, :1] + radius * points.x - disk.x_mm) / unit
            py = (cy + down[:, 1:] + radius * points.y - disk.y_mm) / unit
        value = np.empty((len(self.wave), *px.shape))
        for w, nm in enumerate(self.wave):
            rays = Rays.create(
                x_mm=disk.x_mm + px * unit,
                y_mm=disk.y_mm + py * unit,
                z_mm=disk.z_mm,
                direction=np.broadcast_to(light[:, None, :], (*px.shape, 3)),
                wavelength_nm=np.full(px.shape, nm),
            )
            losses, ones = self.losses, np.ones(px.size)
            out = trace_ghost(lens, None, rays, ones, coating=losses.coating, absorption=losses.absorption)
            value[w] = np.where(out.rays.status == OK, out.weight / self.on_axis[w], np.nan).reshape(px.shape)
        return _Samples(light, px, py, value)


def _fit(
    turned: bool, disk: int, total: int, reach: float, fitted_rays: _Samples, test_rays: _Samples
) -> PupilTransmission:
    power, field_power = _powers(turned, disk, total)
    pairs, term = np.unique(power, axis=0, return_inverse=True)
    empty = PupilTransmission(
        turned, reach, power, field_power, np.asarray(term).ravel(), pairs, np.empty((0, len(power))), 0.0
    )

    def basis(samples: _Samples) -> FloatArray:
        across = samples.light[:, :2] / reach
        first, second = empty.coordinates(samples.px, samples.py, samples.light[:, :1], samples.light[:, 1:2])
        in_disk = first[..., None] ** power[:, 0] * second[..., None] ** power[:, 1]
        return np.asarray((in_disk * _field_terms(turned, across, field_power)[:, None]).reshape(-1, len(power)))

    rows, value = basis(fitted_rays), fitted_rays.value.reshape(len(fitted_rays.value), -1)
    valid, scale = np.isfinite(value), np.abs(rows).max(0)
    coefficients = np.empty((len(value), len(power)))
    for w in range(len(valid)):  # most have the same rays
        if w == 0 or not np.array_equal(valid[w], valid[w - 1]):
            lit = rows[valid[w]] / scale
            normal_matrix = lit.T @ lit + RIDGE * len(lit) * np.eye(len(power))  # faster than a QR decomposition
        coefficients[w] = np.linalg.solve(normal_matrix, lit.T @ (value[w][valid[w]] - 1.0)) / scale
    coefficients[:, ((power == 0).all(1)) & ((field_power == 0).all(1))] += 1.0
    residual = coefficients @ basis(test_rays).T - test_rays.value.reshape(len(coefficients), -1)
    error = np.nanmax(np.abs(residual))
    return replace(empty, coefficient=coefficients, error=float(error))
