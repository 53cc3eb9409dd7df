"""Ghosts of bright stars as images: the enumerated paths of two reflections (`optics.rays.ghosts`), each as it lands.

Which paths can be seen of a star is told by the ghosts of a few fields, found once per camera; those are traced for the
star, at the mean wavelength of each band. A path's rays, each a Gaussian as wide as rays lie apart (and no narrower
than charge diffusion), make its image; ghosts wider than `WIDEST_PX` are uniform disks of the same RMS radius. A ghost
is light that the response of the camera counts as reflected: it comes on top of what is a star's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.frames import field_direction
from optics.rays.ghosts import SHARP_MM, entering_rays, find_ghosts, trace_ghost
from optics.records import freeze
from render.camera import Camera
from render.records import Truth

__all__ = ["GhostLight", "GhostTruth", "Ghosting"]

FIELDS, ORDER = (0.1, 0.7), (6, 12)
"""Parts of the field whose ghosts tell which can be seen, by so many rays."""
ROOM = 5.0
"""By how much brighter those of other fields are taken to be, at most."""
WIDEST_PX = 150.0
REACH = 4.0
"""Standard deviations to which the light of a ray reaches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GhostLight:
    """Which ghosts are rendered.

    Attributes
    ----------
    least_e : float
        Electrons in the brightest pixel of a ghost below which it is left out.
    detector_reflectance : float
        Share of the light that the detector reflects like a mirror; silicon 0.1 to 0.3.
    """

    least_e: float
    detector_reflectance: float = 0.2

    def __post_init__(self) -> None:
        if not (self.least_e > 0.0 and math.isfinite(self.least_e)):
            raise DomainError(f"GhostLight.least_e = {self.least_e:g} e-; it must be positive")
        if not 0.0 <= self.detector_reflectance <= 1.0:
            raise DomainError(
                f"GhostLight.detector_reflectance = {self.detector_reflectance:g}; it must lie in 0 ... 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class GhostTruth:
    """Ghosts of one image, g of them, each of one star, path and band.

    Attributes
    ----------
    star, band : (g,) int
        Row of the star in the truth, and number of the band.
    back, forward : (g,) int
        Surfaces that turn the light back, then forward again; the number of surfaces is the detector.
    x_px, y_px : (g,)
        Column and row of its centroid, on the detector or beside it.
    radius_px : (g,)
        Of the uniform disk with the same RMS radius.
    electrons, electrons_image : (g,)
        All of its light, and what of it lies on the detector.
    peak_e : (g,)
        Electrons in the brightest pixel, taken for a uniform disk.
    sharp : (g,) bool
        Whether it is small enough to be taken for a star: a candidate for a false one.
    """

    star: IntArray
    band: IntArray
    back: IntArray
    forward: IntArray
    x_px: FloatArray
    y_px: FloatArray
    radius_px: FloatArray
    electrons: FloatArray
    electrons_image: FloatArray
    peak_e: FloatArray
    sharp: NDArray[np.bool_]

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for name in self.__dataclass_fields__:
            kind = np.bool_ if name == "sharp" else np.int64 if name in ("star", "band", "back", "forward") else float
            freeze(self, name, shape=("g",), dtype=kind, sizes=sizes)

    def __len__(self) -> int:
        return len(self.star)


class Ghosting:
    """Adds ghosts of the stars of one camera.

    Parameters
    ----------
    camera : Camera
        Its lens with the cover glass of the detector (`optics.rays.ghosts.with_cover_glass`).
    light : GhostLight
        Which ghosts.

    Raises
    ------
    DomainError
        A lens without surfaces.
    """

    def __init__(self, camera: Camera, light: GhostLight) -> None:
        camera.lens.check_surfaces()
        self.camera, self.light, self.lens = camera, light, camera.focused_lens
        losses = camera.losses
        self.coating = None if losses is None else losses.coating
        self.absorption = losses is not None and losses.absorption
        self._seen: dict[float, dict[tuple[int, int], float]] = {}

    def add(
        self, image: NDArray[np.float32], direction: FloatArray, wavelength_nm: FloatArray, truth: Truth
    ) -> GhostTruth:
        """Add ghosts of stars in directions (n, 3) in cam, whose truth is known, to an image (h, w, b)."""
        assert truth.electrons_absorbed is not None
        through = truth.electrons_in - truth.electrons_vignetted - truth.electrons_hidden - truth.electrons_absorbed
        rows: list[tuple[Any, ...]] = []
        for band, nm in enumerate(wavelength_nm.mean(1).tolist()):
            shares = self._shares(nm)
            brightest = ROOM * max(shares.values(), default=0.0)
            for star in np.flatnonzero(through[:, band] * brightest > self.light.least_e).tolist():
                electrons = float(through[star, band])
                pairs = [pair for pair, share in shares.items() if ROOM * share * electrons > self.light.least_e]
                rows += [
                    (star, band, *one) for one in self._star(image[..., band], direction[star], nm, electrons, pairs)
                ]
        names = list(GhostTruth.__dataclass_fields__)
        columns = zip(*rows, strict=True) if rows else ([] for _ in names)
        return GhostTruth(**{name: np.array(values) for name, values in zip(names, columns, strict=True)})

    def _shares(self, nm: float) -> dict[tuple[int, int], float]:
        """Light in the brightest pixel of every path as a share of the image, the most of some fields."""
        if nm not in self._seen:
            found: dict[tuple[int, int], float] = {}
            for part in FIELDS:
                star = field_direction(math.degrees(part * self.camera.field_reach_rad), 0.0)
                try:
                    ghosts = find_ghosts(
                        self.lens,
                        star,
                        wavelength_nm=nm,
                        coating=self.coating,
                        detector_reflectance=self.light.detector_reflectance,
                        absorption=self.absorption,
                        order=ORDER,
                    )
                except DomainError:  # the lens images no star there
                    continue
                shares = ghosts.pixel_share(self.camera.pixel_pitch_mm)
                for pair, share in zip(zip(ghosts.back, ghosts.forward, strict=True), shares, strict=True):
                    key = int(pair[0]), int(pair[1])
                    found[key] = max(found.get(key, 0.0), float(share))
            self._seen[nm] = found
        return self._seen[nm]

    def _star(
        self, image: NDArray[np.float32], star: FloatArray, nm: float, electrons: float, pairs: list[tuple[int, int]]
    ) -> list[tuple[Any, ...]]:
        """Add ghosts of one star in one band; their rows of the truth."""
        rays, entering = entering_rays(self.lens, star, nm)
        more: dict[str, Any] = {
            "coating": self.coating,
            "detector_reflectance": self.light.detector_reflectance,
            "absorption": self.absorption,
        }
        direct = float(trace_ghost(self.lens, None, rays, entering, **more).weight.sum())
        found: list[tuple[Any, ...]] = []
        for back, forward in pairs if direct > 0.0 else []:
            one = trace_ghost(self.lens, (back, forward), rays, entering, **more)
            lit = one.weight > 0.0
            if not lit.any():
                continue
            x, y = self.camera.to_pixel(one.rays.x[lit], one.rays.y[lit])
            light = one.weight[lit] * (electrons / direct)
            total = float(light.sum())
            middle = float(light @ x) / total, float(light @ y) / total
            square = float(light @ ((x - middle[0]) ** 2 + (y - middle[1]) ** 2)) / total
            radius = math.sqrt(2.0 * square)
            peak = total / max(math.pi * radius**2, 1.0)
            if peak < self.light.least_e:
                continue
            on_image = self._draw(image, x, y, light, middle, radius)
            sharp = math.sqrt(square) * self.camera.pixel_pitch_mm < SHARP_MM
            found.append((back, forward, *middle, radius, total, on_image, peak, sharp))
        return found

    def _draw(
        self,
        image: NDArray[np.float32],
        x: FloatArray,
        y: FloatArray,
        light: FloatArray,
        middle: tuple[float, float],
        radius: float,
    ) -> float:
        """Add the rays of one ghost, or its disk; electrons on the image."""
        sigma = max(self.camera.blur_px, 1.5 * radius / math.sqrt(len(x)), 0.05)
        wide = radius > WIDEST_PX
        ends = [(m - radius - 1.0, m + radius + 1.0) for m in middle] if wide else [
            (float(v.min()) - REACH * sigma, float(v.max()) + REACH * sigma) for v in (x, y)
        ]  # fmt: skip
        (left, right), (top, bottom) = (
            (max(0, math.floor(low)), min(size, math.ceil(high) + 1))
            for (low, high), size in zip(ends, image.shape[::-1], strict=True)
        )
        if left >= right or top >= bottom:
            return 0.0
        if wide:
            columns, rows = np.arange(left, right) - middle[0], np.arange(top, bottom) - middle[1]
            part = np.clip(radius + 0.5 - np.hypot(columns, rows[:, None]), 0.0, 1.0)
            pixels = part * (light.sum() / (math.pi * radius**2))
        else:
            along_x, along_y = (
                0.5 * np.diff(erf((np.arange(low, high + 1) - 0.5 - v[:, None]) / (math.sqrt(2.0) * sigma)), axis=1)
                for v, low, high in ((x, left, right), (y, top, bottom))
            )
            pixels = (along_y * light[:, None]).T @ along_x
        if self.camera.sensitive_columns is not None:
            pixels = pixels * self.camera.sensitive_columns[left:right]
        image[top:bottom, left:right] += pixels.astype(np.float32)
        return float(pixels.sum())
