"""Stamps into the image, and sums into the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.records import Truth
from render.tracing.rays.kernel import ARRIVED, FIRST, HIDDEN, LOST, OUTSIDE, SECOND, STRIPS, StampSums
from render.tracing.waves.images import WaveStamps

__all__ = ["TruthSums", "add_stamps"]


def add_stamps(
    image: NDArray[Any],
    pixels: FloatArray | NDArray[np.float32],
    corner_px: FloatArray,
    electrons: FloatArray,
    sensitive: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Add stamps to the image, in the order of the stars."""
    # image (h, w, b), pixels (s, b, m, m), corner_px (s, b, 2), electrons (s, b) [e-], sensitive (w,) -> (s, b)
    _, bands, size, _ = pixels.shape
    height, width, _ = image.shape
    column = np.rint(corner_px[..., 0] + 0.5).astype(np.int64)[..., None] + np.arange(size)
    row = np.rint(corner_px[..., 1] + 0.5).astype(np.int64)[..., None] + np.arange(size)
    on_row, on_column = (row >= 0) & (row < height), (column >= 0) & (column < width)
    if sensitive is not None and width:
        on_column &= sensitive[np.clip(column, 0, width - 1)]
    lit = (on_row[..., :, None] & on_column[..., None, :]) & (pixels > 0)
    star, band, r, c = np.nonzero(lit)
    share = pixels[star, band, r, c]
    flat = (row[star, band, r] * width + column[star, band, c]) * bands + band
    np.add.at(image.reshape(-1), flat, (share * electrons[star, band]).astype(image.dtype))
    kept = np.asarray(np.bincount(star * bands + band, weights=share, minlength=pixels.shape[0] * bands), float)
    return kept.reshape(pixels.shape[:2])


@dataclass(frozen=True, slots=True)
class TruthSums:
    """Truth under construction, every field (n, b); NaN until stored."""

    chief_x: FloatArray
    chief_y: FloatArray
    bundle_x: FloatArray
    bundle_y: FloatArray
    photon_x: FloatArray
    photon_y: FloatArray
    image: FloatArray
    vignetted: FloatArray
    off_edge: FloatArray
    hidden: FloatArray
    variance_x: FloatArray
    variance_y: FloatArray
    beyond: FloatArray
    entrance: FloatArray

    @classmethod
    def empty(cls, stars: int, bands: int) -> TruthSums:
        """Nothing known yet, and nothing beyond stamps."""
        sums = cls(*(np.full((stars, bands), np.nan) for _ in cls.__dataclass_fields__))
        sums.beyond[...] = 0.0
        return sums

    def store(
        self,
        stars: NDArray[np.int64],
        sums: StampSums,
        corner_px: FloatArray,
        electrons_in: FloatArray,
        on_image: FloatArray,
        entrance: FloatArray,
    ) -> None:
        """Moments and balance of one pass."""
        # stars (s,), corner_px (s, b, 2), electrons_in (s, b) [e-], on_image (s, b), entrance (s, b)
        size, moments = sums.pixels.shape[-1], sums.moments
        landed = sums.pixels.sum((2, 3))
        with np.errstate(invalid="ignore", divide="ignore"):
            arrived = moments[..., ARRIVED, None]
            mean = moments[..., FIRST] / arrived
            variance = moments[..., SECOND] / arrived - mean**2
            photon = moments[..., STRIPS] / arrived
        self.bundle_x[stars] = corner_px[..., 0] + mean[..., 0] * size
        self.bundle_y[stars] = corner_px[..., 1] + mean[..., 1] * size
        self.variance_x[stars] = variance[..., 0] * size**2
        self.variance_y[stars] = variance[..., 1] * size**2
        self.photon_x[stars] = corner_px[..., 0] + photon[..., 0] * size
        self.photon_y[stars] = corner_px[..., 1] + photon[..., 1] * size
        self.entrance[stars] = entrance
        self.image[stars] = on_image * electrons_in
        self.vignetted[stars] = moments[..., LOST] * electrons_in
        self.off_edge[stars] = (landed - on_image + moments[..., OUTSIDE]) * electrons_in
        self.hidden[stars] = moments[..., HIDDEN] * electrons_in

    def store_waves(self, stamps: WaveStamps, electrons_in: FloatArray, on_image: FloatArray) -> None:
        """What diffraction makes of stars whose rays are stored, or come with it; parameters as `store`."""
        stars, landed = stamps.stars, stamps.pixels.sum((2, 3), dtype=np.float64)
        if (rays := stamps.moments) is not None:
            self.bundle_x[stars], self.bundle_y[stars] = rays.mean_px[..., 0], rays.mean_px[..., 1]
            self.variance_x[stars], self.variance_y[stars] = rays.variance_px2[..., 0], rays.variance_px2[..., 1]
            if rays.entrance is not None:
                self.entrance[stars], self.hidden[stars] = rays.entrance, 0.0
        self.photon_x[stars], self.photon_y[stars] = stamps.mean_px[..., 0], stamps.mean_px[..., 1]
        self.image[stars] = on_image * electrons_in
        self.off_edge[stars] = (landed - on_image) * electrons_in
        self.beyond[stars] = (stamps.light - landed) * electrons_in
        hidden = np.nan_to_num(self.hidden[stars])
        self.entrance[stars] = np.maximum(self.entrance[stars], stamps.light + hidden / electrons_in)
        self.vignetted[stars] = (self.entrance[stars] - stamps.light) * electrons_in - hidden

    def put(self, stars: NDArray[np.int64], others: TruthSums) -> None:
        """Take over what is known of some stars."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[stars] = getattr(others, name)

    def truth(self, electrons: FloatArray) -> Truth:
        """The finished record, from the light of the launch disk (n, b)."""
        return Truth(
            chief_x_px=self.chief_x,
            chief_y_px=self.chief_y,
            bundle_x_px=self.bundle_x,
            bundle_y_px=self.bundle_y,
            photon_x_px=self.photon_x,
            photon_y_px=self.photon_y,
            electrons_in=electrons * self.entrance,
            electrons_image=self.image,
            electrons_vignetted=self.vignetted,
            electrons_off_edge=self.off_edge,
            electrons_hidden=self.hidden,
            variance_x_px2=self.variance_x,
            variance_y_px2=self.variance_y,
            electrons_beyond=self.beyond,
        )
