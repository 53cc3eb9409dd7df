"""Stamps added to the image; sums converted to the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from render.records import Truth
from render.tracing.rays.kernel import ARRIVED, CLEAR, FIRST, HIDDEN, LOST, OUTSIDE, SECOND, STRIPS, StampSums


def add_stamps(
    image: NDArray[Any],
    pixels: NDArray[Any],
    corner_px: FloatArray,
    electrons: FloatArray,
    sensitive: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Add stamps, which are nowhere negative, to the image, in the order of the stars."""
    # image (h, w, b), pixels (s, b, m, m), corner_px (s, b, 2), electrons (s, b) [e-], sensitive (w,) -> (s, b)
    height, width, _ = image.shape
    first = np.rint(corner_px + 0.5).astype(np.int64)
    size = pixels.shape[-1]
    low, high = np.maximum(first, 0), np.minimum(first + size, [width, height])
    scaled = pixels * np.asarray(electrons, pixels.dtype)[..., None, None]
    inside = (high - low == size).all(2) & (sensitive is None)
    on_image = np.where(inside, pixels.sum((2, 3), dtype=np.float64), 0.0)
    for s, b in np.argwhere((low < high).all(2)).tolist():
        (x0, y0), (x1, y1), (column, row) = low[s, b].tolist(), high[s, b].tolist(), first[s, b].tolist()
        part = np.s_[s, b, y0 - row : y1 - row, x0 - column : x1 - column]
        light = scaled[part]
        if not inside[s, b]:
            lit = np.ones(x1 - x0) if sensitive is None else sensitive[x0:x1]
            on_image[s, b] = (pixels[part] * lit).sum(dtype=np.float64)
            light = light * lit
        image[y0:y1, x0:x1, b] += light.astype(image.dtype)
    return on_image


Sampling = dict[str, tuple[int, int]]
"""How pupils were sampled: mode -> (stars, rays per star and band)."""


def check_lit(position_px: FloatArray) -> None:
    """Refuse stars none of whose light arrives: their positions (n, b, 2) are NaN."""
    if np.isnan(position_px).any():
        raise DomainError(f"star {np.argwhere(np.isnan(position_px))[0][0]}: none of its light reaches the detector")


@dataclass(frozen=True, slots=True)
class RayMoments:
    """Ray moments of s stars in b bands."""

    mean_px: FloatArray  # (s, b, 2) Mean of the landing points along columns and rows
    variance_px2: FloatArray  # (s, b, 2) Their variance
    # (s, b) Light that the stop alone would let through over that of the launch disk; None if already stored
    entrance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class WaveStamps:
    """Stamps of s stars, all of one size."""

    stars: IntArray  # (s,)
    pixels: FloatArray | NDArray[np.float32]  # (s, b, m, m) Light per pixel over the light sent into the launch disk
    corner_px: FloatArray  # (s, b, 2) Outer corner (column, row)
    mean_px: FloatArray  # (s, b, 2) Centroid of all light of the image, on the stamp or beyond, NaN without light
    light: FloatArray  # (s, b) Light that gets through the lens, likewise
    rays: int  # Of a star, band and wavelength
    mode: str  # How the pupils were sampled
    moments: RayMoments | None = None  # Of the stars' rays; not of cells, some of which are covered in part
    clear: FloatArray | None = None  # (s, b) ``light`` before losses in surfaces and glasses beyond those of the axis


@dataclass(frozen=True, slots=True)
class TruthSums:
    """Truth under construction, every field (n, b) or, of positions, (n, b, 2): column and row; NaN until stored."""

    chief: FloatArray
    bundle: FloatArray
    photon: FloatArray
    variance: FloatArray
    image: FloatArray
    vignetted: FloatArray
    off_edge: FloatArray
    hidden: FloatArray
    beyond: FloatArray
    entrance: FloatArray
    noise_area: FloatArray
    absorbed: FloatArray

    @classmethod
    def empty(cls, stars: int, bands: int) -> TruthSums:
        """NaN, and no light beyond stamps or absorbed."""
        positions, light = np.full((4, stars, bands, 2), np.nan), np.full((8, stars, bands), np.nan)
        light[[4, 7]] = 0.0
        return cls(*positions, *light)

    def store(
        self,
        stars: NDArray[np.int64],
        sums: StampSums,
        corner_px: FloatArray,
        electrons_in: FloatArray,
        on_image: FloatArray,
        entrance: FloatArray,
    ) -> None:
        """Moments and balance of one pass of rays."""
        # stars (s,), corner_px (s, b, 2), electrons_in (s, b) [e-], on_image (s, b), entrance (s, b)
        size, moments = sums.pixels.shape[-1], sums.moments
        landed = sums.pixels.sum((2, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            arrived = moments[..., ARRIVED, None]
            mean = moments[..., FIRST] / arrived
            variance = moments[..., SECOND] / arrived - mean**2
            photon = moments[..., STRIPS] / arrived
        self.bundle[stars] = corner_px + mean * size
        self.variance[stars] = variance * size**2
        self.photon[stars] = corner_px + photon * size
        self.entrance[stars] = entrance
        self.noise_area[stars] = _noise_area(sums.pixels, landed)
        self.image[stars] = on_image * electrons_in
        self.vignetted[stars] = moments[..., LOST] * electrons_in
        self.off_edge[stars] = (landed - on_image + moments[..., OUTSIDE]) * electrons_in
        self.hidden[stars] = moments[..., HIDDEN] * electrons_in
        passed = moments[..., ARRIVED] + moments[..., OUTSIDE] + moments[..., HIDDEN]
        self.absorbed[stars] = (moments[..., CLEAR] - passed) * electrons_in

    def store_waves(self, stamps: WaveStamps, electrons_in: FloatArray, on_image: FloatArray) -> None:
        """Store diffraction images of stars, and the moments of their rays if they have some; parameters as `store`."""
        stars, landed = stamps.stars, stamps.pixels.sum((2, 3), dtype=np.float64)
        if (rays := stamps.moments) is not None:
            self.bundle[stars], self.variance[stars] = rays.mean_px, rays.variance_px2
            if rays.entrance is not None:
                self.entrance[stars], self.hidden[stars] = rays.entrance, 0.0
        self.photon[stars] = stamps.mean_px
        self.noise_area[stars] = _noise_area(stamps.pixels, landed)
        self.image[stars] = on_image * electrons_in
        self.off_edge[stars] = (landed - on_image) * electrons_in
        self.beyond[stars] = (stamps.light - landed) * electrons_in
        hidden = np.nan_to_num(self.hidden[stars])
        clear = stamps.light if stamps.clear is None else stamps.clear
        self.absorbed[stars] = (clear - stamps.light) * electrons_in
        self.entrance[stars] = np.maximum(self.entrance[stars], clear + hidden / electrons_in)
        self.vignetted[stars] = (self.entrance[stars] - clear) * electrons_in - hidden

    def put(self, stars: NDArray[np.int64], others: TruthSums) -> None:
        """Insert the truth of some stars."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[stars] = getattr(others, name)

    def truth(self, electrons: FloatArray) -> Truth:
        """The finished record, from the light of the launch disk (n, b)."""
        positions = {"chief_{}_px": self.chief, "bundle_{}_px": self.bundle, "photon_{}_px": self.photon}
        positions["variance_{}_px2"] = self.variance
        return Truth(
            **{name.format(axis): v[..., i] for name, v in positions.items() for i, axis in enumerate("xy")},
            electrons_in=electrons * self.entrance,
            electrons_image=self.image,
            electrons_vignetted=self.vignetted,
            electrons_off_edge=self.off_edge,
            electrons_hidden=self.hidden,
            electrons_beyond=self.beyond,
            noise_area_px2=self.noise_area,
            electrons_absorbed=self.absorbed,
        )


def _noise_area(pixels: FloatArray | NDArray[np.float32], landed: FloatArray) -> FloatArray:
    """Square of the sum (s, b) of stamps (s, b, m, m) over their sum of squares; NaN without light."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(landed**2 / np.einsum("sbij,sbij->sb", pixels, pixels))
