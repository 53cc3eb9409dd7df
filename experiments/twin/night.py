"""Frames of a night: detections, blind identification, catalogue stars on the detector."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate
from calib.attitude.identify import Identification
from calib.attitude.identify_unknown_scale import BlindIdentifier
from calib.cameras.base import CameraModel
from calib.detector.sky_photon_transfer import SkyNoise
from calib.flags import StarFlag, has_flag
from calib.measure.background import Background, estimate_background
from calib.measure.centroiding.registry import get_centroider
from calib.measure.detection.filtered_noise import FilteredNoise
from calib.measure.detection.limiting_magnitude import detected_stars
from calib.measure.detection.matched_filter import detect
from calib.measure.stamps import extract_stamps
from calib.photometry.atmosphere import airmass, refracted
from calib.photometry.spectral_response import REFERENCE_K
from calib.psf.gaussian_mixture import colour_class
from calib.psf.star_windows import starlit_pixels
from calib.records import FLUX, NoiseModel, SensorImage, StarTable
from experiments.harness.progress import Progress
from optics.arrays import FloatArray, IntArray
from render.sky.sky import Sky

THRESHOLD_SIGMA = 5.0
"""Detection threshold of the matched filter."""
FWHM_PX = 1.7
"""Width of the matched filter."""
WINDOW_PX = 11
"""Side of the windows of centroids."""
BOX_PX = 64
"""Side of the boxes of the background mesh."""
MARGIN_PX = 12.0
"""Distance of catalogue stars from the edge, at least."""
FIT_SHIFT_PX = 1.5
"""Distance of a Gaussian fit from the detection beyond which its flux and position are meaningless."""
PAIR_PX = 1.5
"""Match radius of detections and catalogue stars."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """Detections of a frame, identified or not."""

    background: Background  # Mesh of level and noise
    stars: StarTable  # All detections at `THRESHOLD_SIGMA`, measured by a Gaussian fit
    start_px: FloatArray  # (n, 2) Position of the detection, start of the fit
    significance: FloatArray  # (n,) Filtered image over its noise
    sharp: NDArray[np.bool_]  # (n,) Hot pixels: sharper than a star, or in the mask

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Detections (n,) with a valid fit that are no hot pixels."""
        shift_px = np.hypot(*(self.stars.pixel_px - self.start_px).T)
        finite = np.isfinite(self.significance)
        return np.asarray((shift_px < FIT_SHIFT_PX) & (self.stars.flux_e > 0) & ~self.sharp & finite)

    def match(self, stars: FieldStars) -> tuple[FloatArray, IntArray]:
        """Significance of catalogue stars (n,), 0 if not detected, and rows of the unmatched detections."""
        rows = np.flatnonzero(np.isfinite(self.significance) & ~self.sharp)
        significance, unmatched = detected_stars(
            stars.position_px, self.start_px[rows], self.significance[rows], PAIR_PX
        )
        return significance, rows[unmatched]


def detections(image: SensorImage, *, noise: FilteredNoise | None = None) -> Detections:
    """Stars of a real or rendered frame; a rendered one takes the filtered noise of the real frame as ``noise``."""
    background = estimate_background(image, box_px=BOX_PX)
    detected = detect(image, background, threshold_sigma=THRESHOLD_SIGMA, fwhm_px=FWHM_PX, noise=noise)
    flux_noise = np.sqrt(np.maximum(detected.covariance[:, FLUX, FLUX] - detected.flux_e, 1e-12))
    stamps = extract_stamps(
        image, detected.x_px, detected.y_px, background=background, size_px=WINDOW_PX, flags=detected.flags
    )
    return Detections(
        background=background,
        stars=get_centroider("gaussian", fit_background=True).measure(stamps, image.noise),
        start_px=detected.pixel_px,
        significance=detected.flux_e / flux_noise,
        sharp=has_flag(detected.flags, StarFlag.SPIKE | StarFlag.DEFECT),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSolution:
    """A frame, its detections, and its blind identification."""

    name: str
    image: SensorImage
    detected: Detections
    identification: Identification
    focal_px: float  # Focal length by the identification
    seconds: float

    @property
    def attitude(self) -> Rotation | None:
        """Camera from ICRS; None where no stars were identified."""
        solution = self.identification.attitude
        return solution.rotation if self.identification.ok and solution is not None else None

    @property
    def summary(self) -> str:
        """Line for the terminal."""
        head = f"{self.name}: {len(self.detected.stars)} detected"
        if self.attitude is None:
            return f"{head}; not solved: {self.identification.message} ({self.seconds:.2f} s)"
        residual = self.identification.residual_px
        rms = float("nan") if residual is None else float(np.sqrt(np.mean(residual**2)))
        return (
            f"{head}, {len(self.identification.detected)} identified, residual {rms:.2f} px, focal length "
            f"{self.focal_px:.1f} px ({self.seconds:.2f} s)"
        )


def identify(detected: Detections, identifier: BlindIdentifier) -> tuple[Identification, float]:
    """Identification of the usable detections, and the focal length [px] of its pinhole."""
    stars = detected.stars.select(detected.usable)
    identification, model = identifier.identify(stars.pixel_px, stars.flux_e)
    return identification, model.value("focal_length_mm")


def solve_all(
    names: Sequence[str], images: Sequence[SensorImage], identifier: BlindIdentifier, progress: Progress
) -> list[FrameSolution]:
    """Detect and identify; frames without a solution are tried a second time, at the scale of the solved ones."""
    solved = []
    with progress.stage("frames solved", total=len(images)) as stage:
        for name, image in zip(names, images, strict=True):
            start = time.perf_counter()
            detected = detections(image)
            identification, focal_px = identify(detected, identifier)
            solved.append(
                FrameSolution(
                    name=name,
                    image=image,
                    detected=detected,
                    identification=identification,
                    focal_px=focal_px,
                    seconds=time.perf_counter() - start,
                )
            )
            progress.note(solved[-1].summary)
            stage.advance()
    for number, frame in enumerate(solved):
        if frame.attitude is None and identifier.focal_px is not None:
            identification, focal_px = identify(frame.detected, identifier)
            if identification.ok:
                solved[number] = replace(frame, identification=identification, focal_px=focal_px)
    return solved


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiedFrame:
    """A solved frame with the stars about its boresight."""

    name: str
    image: SensorImage
    detected: Detections
    zenith: FloatArray | None  # (3,) Direction of the zenith, ICRS; None: unknown
    rows: IntArray  # (m,) Stars of the sky
    direction: FloatArray  # (m, 3) Apparent, refraction included
    taken: datetime | None = None

    def matched(self, attitude: Rotation, camera: CameraModel, radius_px: float) -> tuple[IntArray, IntArray]:
        """Rows of the detections that can take part in a calibration, and of their stars in ``direction``."""
        rows = np.flatnonzero(self.detected.usable & self.detected.stars.fit)
        pairs = associate(self.detected.stars.pixel_px[rows], self.direction, attitude, camera, radius_px=radius_px)
        return rows[pairs.detected], pairs.catalogue


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedNight:
    """Solved frames of one camera."""

    frames: tuple[IdentifiedFrame, ...]
    sky: Sky  # Proper motion, aberration; not refracted

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows."""
        height, width = self.frames[0].image.dn.shape
        return width, height

    def refracted_towards(self, zenith: FloatArray, arcsec: float) -> SolvedNight:
        """The night with refraction towards zeniths (frames, 3); ``arcsec``: refraction / tan z."""
        frames = []
        for frame, up in zip(self.frames, zenith, strict=True):
            apparent = refracted(np.array(self.sky.direction[frame.rows]), up, arcsec)
            frames.append(replace(frame, zenith=up, direction=apparent))
        return replace(self, frames=tuple(frames))


def stars_about(sky: Sky, attitude: Rotation, camera: CameraModel) -> IntArray:
    """Rows of the stars within 1.5 times the field angle of the corners."""
    corners = camera.unproject(camera.geometry.corners_px)
    cos_radius = np.cos(1.5 * np.arccos(np.clip(np.nanmin(corners[:, 2]), -1.0, 1.0)))
    return np.flatnonzero(sky.direction @ attitude.as_matrix()[2] > cos_radius)


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldStars:
    """Catalogue stars on the detector of a frame, the brightest first."""

    row: IntArray  # (n,) Rows of the sky's stars
    direction: FloatArray  # (n, 3) Unit vectors, camera frame
    position_px: FloatArray  # (n, 2)
    magnitude: FloatArray  # (n,)
    temperature_k: FloatArray  # (n,)
    airmass: FloatArray  # (n,) NaN: zenith unknown
    u2: FloatArray  # (n,) Squared distance from the centre over half of the diagonal: 1 in the corner

    def __len__(self) -> int:
        return len(self.row)

    @property
    def colour(self) -> FloatArray:
        """5040 K over the colour temperature (n,)."""
        return REFERENCE_K / self.temperature_k

    @property
    def colour_class(self) -> IntArray:
        """Class (n,) of the PSF."""
        return colour_class(self.temperature_k)


def field_stars(frame: IdentifiedFrame, sky: Sky, camera: CameraModel, attitude: Rotation) -> FieldStars:
    """Catalogue stars and their positions in a frame."""
    direction_cam = attitude.apply(frame.direction)
    visible = np.flatnonzero(camera.visible(direction_cam, margin_px=MARGIN_PX))
    visible = visible[np.argsort(sky.magnitude[frame.rows[visible]], kind="stable")]
    rows, direction_cam, apparent = frame.rows[visible], direction_cam[visible], frame.direction[visible]
    position, geometry = camera.project(direction_cam), camera.geometry
    return FieldStars(
        row=rows,
        direction=direction_cam,
        position_px=position,
        magnitude=np.array(sky.magnitude[rows]),
        temperature_k=np.array(sky.temperature_k[rows]),
        airmass=np.full(len(rows), np.nan) if frame.zenith is None else airmass(apparent, frame.zenith),
        u2=4.0 * ((position - geometry.centre_px) ** 2).sum(axis=1) / (geometry.width_px**2 + geometry.height_px**2),
    )


def masked_pixels(
    image: SensorImage, stars: FieldStars, detected: Detections, hot: NDArray[np.bool_], width_px: float
) -> NDArray[np.bool_]:
    """Pixels (h, w) with light of stars, detections or defects."""
    starlit = starlit_pixels(
        image.dn.shape, stars.position_px, stars.magnitude, detected_px=detected.start_px, width_px=width_px
    )
    return starlit | ~image.valid | image.saturated | hot


def with_noise(image: SensorImage, noise: SkyNoise) -> SensorImage:
    """The image with its measured noise model, at the lowest possible black level."""
    model = NoiseModel(
        read_noise_e=noise.read_noise_e[0],
        gain_dn_per_e=1.0 / noise.gain_e_per_dn,
        offset_dn=noise.black_level_dn[0],
        quantised=True,
    )
    return replace(image, noise=model, assumed=())
