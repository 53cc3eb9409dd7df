"""Common data of the frames of a night: identified stars, the sky above them, image positions of catalogue stars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from calib.cameras.base import CameraModel
from calib.detector.sky_transfer import SkyNoise
from calib.records import NoiseModel, SensorImage
from experiments.twin.camera import airmass, refracted
from experiments.twin.psf import StarSample, colour_class
from experiments.twin.solve import Detections
from optics.arrays import FloatArray, IntArray
from render.sky.sky import Sky

MARGIN_PX = 12.0
MASK_RADII = ((9.8, 3.0), (8.0, 5.0), (6.5, 8.0), (4.5, 14.0), (2.5, 30.0))
"""Radius [px] of the disk masked about a star brighter than a magnitude, for stars of width 0.65 px."""
MASK_WIDTH_PX = 0.65
NEIGHBOUR_MAG = 3.5
"""A star counts as alone if no other one less than this much fainter is within `REACH_PX`."""
LINEAR_SHARE = 0.85
"""Pixels above this share of the highest one of all frames may be full, though the converter is not at its end."""
REACH_PX = 9.0
FAINTER_MAG, OTHER_PX = 1.5, 5.0
"""Magnitudes below a sample's faintest star up to which pixels about stars are left out of the windows of others."""
REFERENCE_K = 5040.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A solved frame."""

    name: str
    image: SensorImage
    seen: Detections
    zenith: FloatArray | None  # (3,) In icrs; None where it is not known
    rows: IntArray  # (m,) Stars of the sky about the boresight
    direction: FloatArray  # (m, 3) Where they are seen, refraction included
    taken: datetime | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Night:
    """Solved frames of one camera."""

    frames: tuple[Frame, ...]
    sky: Sky  # Proper motion, aberration; not refracted
    refraction_arcsec: float  # Of tan z; 0 where the zenith is not known

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows."""
        height, width = self.frames[0].image.dn.shape
        return width, height

    def under(self, zenith: FloatArray, arcsec: float) -> Night:
        """The same night with refraction towards a zenith (frames, 3)."""
        frames = []
        for one, up in zip(self.frames, zenith, strict=True):
            seen = refracted(np.array(self.sky.direction[one.rows]), up, arcsec)
            frames.append(replace(one, zenith=up, direction=seen))
        return replace(self, frames=tuple(frames), refraction_arcsec=arcsec)


def stars_about(sky: Sky, attitude: Rotation, camera: CameraModel) -> IntArray:
    """Rows of the stars that a frame may hold: half as far again as its corners."""
    corners = camera.unproject(camera.geometry.corners_px)
    reach = np.cos(1.5 * np.arccos(np.clip(np.nanmin(corners[:, 2]), -1.0, 1.0)))
    return np.flatnonzero(sky.direction @ attitude.as_matrix()[2] > reach)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldStars:
    """Catalogue stars on the detector of one frame, the brightest first."""

    row: IntArray  # (n,) Of the sky
    direction: FloatArray  # (n, 3) In cam
    place_px: FloatArray  # (n, 2)
    magnitude: FloatArray  # (n,)
    temperature_k: FloatArray  # (n,)
    airmass: FloatArray  # (n,) NaN where the zenith is not known

    def __len__(self) -> int:
        return len(self.row)

    @property
    def colour(self) -> FloatArray:
        """5040 K over the colour temperature (n,)."""
        return REFERENCE_K / self.temperature_k

    @property
    def colour_class(self) -> IntArray:
        """Class (n,), as of `experiments.twin.psf`."""
        return colour_class(self.temperature_k)

    def alone(self, reach_px: float) -> NDArray[np.bool_]:
        """Stars (n,) without a neighbour that would matter."""
        near = cKDTree(self.place_px).query_pairs(reach_px, output_type="ndarray")
        out = np.ones(len(self), bool)
        for one, other in (near.T, near.T[::-1]):
            out[one[self.magnitude[other] < self.magnitude[one] + NEIGHBOUR_MAG]] = False
        return out


def field_stars(night: Night, number: int, camera: CameraModel, attitude: Rotation) -> FieldStars:
    """Catalogue stars and their positions in a frame."""
    frame = night.frames[number]
    v_cam = attitude.apply(frame.direction)
    shown = camera.visible(v_cam, margin_px=MARGIN_PX)
    near, v_cam, seen = frame.rows[shown], v_cam[shown], frame.direction[shown]
    order = np.argsort(night.sky.magnitude[near], kind="stable")
    near, v_cam, seen = near[order], v_cam[order], seen[order]
    zenith = frame.zenith
    return FieldStars(
        row=near,
        direction=v_cam,
        place_px=camera.project(v_cam),
        magnitude=np.array(night.sky.magnitude[near]),
        temperature_k=np.array(night.sky.temperature_k[near]),
        airmass=np.full(len(near), np.nan) if zenith is None else airmass(seen, zenith),
    )


def star_mask(
    image: SensorImage, stars: FieldStars, seen: Detections, hot: NDArray[np.bool_], width_px: float
) -> NDArray[np.bool_]:
    """Pixels (h, w) with light of stars, detections or defects."""
    height, width = image.dn.shape
    grow = max(width_px / MASK_WIDTH_PX, 0.6)
    out = ~image.valid | image.saturated | hot
    places = [(stars.place_px[stars.magnitude < limit], radius * grow) for limit, radius in MASK_RADII]
    places.append((seen.start_px, 5.0 * grow))
    for place, radius in places:
        at = np.rint(place[np.isfinite(place).all(axis=1)]).astype(np.int64)
        at = at[(at[:, 0] >= 0) & (at[:, 0] < width) & (at[:, 1] >= 0) & (at[:, 1] < height)]
        if len(at):
            free = np.ones((height, width), bool)
            free[at[:, 1], at[:, 0]] = False
            out |= distance_transform_edt(free) <= radius
    return out


def star_sample(
    frames: Sequence[tuple[Frame, FieldStars]],
    *,
    brightest_mag: float,
    faintest_mag: float,
    size_px: int,
    hot: NDArray[np.bool_],
) -> StarSample:
    """Windows about isolated, unsaturated catalogue stars between two magnitudes."""
    half = size_px // 2
    highest = LINEAR_SHARE * max(float(frame.image.dn[frame.image.valid & ~hot].max()) for frame, _ in frames)
    parts: list[StarSample] = []
    for number, (frame, stars) in enumerate(frames):
        image = frame.image
        height, width = image.dn.shape
        x, y = stars.place_px.T
        inside = (x > half + 1) & (x < width - half - 2) & (y > half + 1) & (y < height - half - 2)
        rows = np.flatnonzero(
            inside & (stars.magnitude >= brightest_mag) & (stars.magnitude < faintest_mag) & stars.alone(REACH_PX)
        )
        middle = np.rint(stars.place_px[rows]).astype(np.int64)
        at_y = (middle[:, 1, None] - half + np.arange(size_px))[:, :, None]
        at_x = (middle[:, 0, None] - half + np.arange(size_px))[:, None, :]
        sky_e = frame.seen.background.level_at(x[rows], y[rows])
        level = image.noise.offset_dn + image.noise.gain_dn_per_e * sky_e
        pixels = image.dn[at_y, at_x]
        whole = ~(image.saturated[at_y, at_x] | (pixels > highest)).any(axis=(1, 2))
        rows, middle, at_y, at_x, level = rows[whole], middle[whole], at_y[whole], at_x[whole], level[whole]
        parts.append(
            StarSample(
                dn=pixels[whole] - level[:, None, None],
                offset_px=stars.place_px[rows] - middle,
                place_px=stars.place_px[rows],
                colour=stars.colour_class[rows],
                frame=np.full(len(rows), number),
                star=rows,
                level_dn=level,
                valid=image.valid[at_y, at_x] & ~hot[at_y, at_x] & ~_others(stars, rows, at_x, at_y, faintest_mag),
            )
        )
    return StarSample(
        **{name: np.concatenate([getattr(one, name) for one in parts]) for name in StarSample.__dataclass_fields__}
    )


def _others(
    stars: FieldStars, rows: IntArray, at_x: IntArray, at_y: IntArray, faintest_mag: float
) -> NDArray[np.bool_]:
    """Pixels (n, s, s) nearer to another star than to their own, which stars of some brightness reach."""
    bright = np.flatnonzero(stars.magnitude < faintest_mag + FAINTER_MAG)
    x, y = np.broadcast_arrays(at_x, at_y)
    if not len(bright) or not x.size:
        return np.zeros(x.shape, bool)
    far, near = cKDTree(stars.place_px[bright]).query(np.stack([x, y], axis=-1))
    return np.asarray((bright[near] != rows[:, None, None]) & (far < OTHER_PX))


def with_noise(image: SensorImage, noise: SkyNoise) -> SensorImage:
    """The image with what was measured of its noise; the lowest black level is taken."""
    gain = 1.0 / noise.gain_e_per_dn
    model = NoiseModel(
        read_noise_e=noise.read_noise_e[0], gain_dn_per_e=gain, offset_dn=noise.black_level_dn[0], quantised=True
    )
    return replace(image, noise=model, assumed=())
