"""From frames to identified stars: detection, blind identification without a stated scale, deep matching."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate
from calib.attitude.identify import Identification, failed, identify
from calib.attitude.patterns import kept_database
from calib.attitude.solve import solve_wahba
from calib.cameras import BrownConrady, SensorGeometry
from calib.cameras.base import CameraModel
from calib.flags import StarFlag, has_flag
from calib.measure.background import Background, estimate_background
from calib.measure.centroid import get_centroider
from calib.measure.detection import detect
from calib.measure.filtered_noise import FilteredNoise
from calib.measure.stamps import extract_stamps
from calib.records import FLUX, SensorImage, StarTable
from experiments.harness.progress import Progress
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError

THRESHOLD_SIGMA, FWHM_PX = 5.0, 1.7
WINDOW_PX = 11
BOX_PX = 64
FIELDS_DEG = (11.0, 18.0, 7.0, 30.0, 4.5, 50.0, 2.9)
"""Widths of the field that are tried, the commonest of star cameras first; each reaches `FIELD_REACH` to both sides."""
FIELD_REACH, STATED_REACH = 0.3, 0.06
"""Part by which the field may differ from the one that is tried, or from a stated one."""
FEWEST = 4
BRIGHTEST = 80
"""Largest number of detections in the blind search."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """Detections of a frame, identified or not."""

    background: Background  # Mesh of level and noise
    stars: StarTable  # All detections at `THRESHOLD_SIGMA`, measured by a Gaussian fit; first the highest
    start_px: FloatArray  # (n, 2) Where they were detected
    significance: FloatArray  # (n,) Height of the filtered image over its noise
    sharp: NDArray[np.bool_]  # (n,) Hot pixels: sharper than a star, or in the mask
    seconds: float  # Time for it

    @property
    def sane(self) -> NDArray[np.bool_]:
        """Detections whose fit stayed where they were detected: others carry any flux and place."""
        moved = np.linalg.norm(self.stars.pixel_px - self.start_px, axis=1)
        return np.asarray((moved < 1.5) & (self.stars.flux_e > 0) & ~self.sharp & np.isfinite(self.significance))


def detections(image: SensorImage, *, noise: FilteredNoise | None = None) -> Detections:
    """Stars of a frame; the same call for real and rendered frames, and for these the limit of the real one."""
    start = time.perf_counter()
    background = estimate_background(image, box_px=BOX_PX)
    found = detect(image, background, threshold_sigma=THRESHOLD_SIGMA, fwhm_px=FWHM_PX, noise=noise)
    flux_noise = np.sqrt(np.maximum(found.covariance[:, FLUX, FLUX] - found.flux_e, 1e-12))
    place = found.pixel_px
    stamps = extract_stamps(image, found.x_px, found.y_px, background=background, size_px=WINDOW_PX, flags=found.flags)
    stars = get_centroider("gaussian", fit_background=True).measure(stamps, image.noise)
    return Detections(
        background=background,
        stars=stars,
        start_px=place,
        significance=found.flux_e / flux_noise,
        sharp=has_flag(found.flags, StarFlag.SPIKE | StarFlag.DEFECT),
        seconds=time.perf_counter() - start,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """A frame, its detections, and its attitude."""

    name: str
    image: SensorImage
    seen: Detections
    attitude: Rotation | None  # cam from icrs; None where no stars were identified
    identified: int  # Stars of the blind solution
    residual_px: float  # Of these, RMS per axis
    scale: float  # Focal length [px] that the frame shows
    words: str  # What became of it
    seconds: float

    @property
    def line(self) -> str:
        """One line for the terminal."""
        head = f"{self.name}: {len(self.seen.stars)} detected"
        if self.attitude is None:
            return f"{head}; not solved: {self.words} ({self.seconds:.2f} s)"
        return (
            f"{head}, {self.identified} identified, residual {self.residual_px:.2f} px, focal length {self.scale:.1f} "
            f"px ({self.seconds:.2f} s)"
        )


class Solver:
    """Blind identification; the scale of the first frame narrows the search for the next ones."""

    def __init__(
        self, width_px: int, height_px: int, *, field_deg: float | None = None, fields_deg: Sequence[float] = ()
    ) -> None:
        self.size_px = (width_px, height_px)
        self._fields = tuple(fields_deg) or FIELDS_DEG if field_deg is None else (field_deg,)
        self._reach = FIELD_REACH if field_deg is None else STATED_REACH
        self._databases: dict[float, Any] = {}
        self.focal_px: float | None = None

    def _camera(self, focal_px: float) -> BrownConrady:
        geometry = SensorGeometry(width_px=self.size_px[0], height_px=self.size_px[1], pixel_pitch_mm=1.0)
        return BrownConrady.create(geometry, focal_length_mm=focal_px)

    def database(self, field_deg: float) -> Any:
        """Patterns for fields around one, kept on disk."""
        if field_deg not in self._databases:
            low, high = field_deg * (1.0 - self._reach), field_deg * (1.0 + self._reach)
            self._databases[field_deg] = kept_database(min_fov_deg=round(low, 2), max_fov_deg=round(high, 2))
        return self._databases[field_deg]

    def identify(self, seen: Detections) -> tuple[Identification, CameraModel]:
        """Names of the brightest stars, and the pinhole they were found with."""
        rows = np.flatnonzero(seen.sane)
        rows = rows[np.argsort(-seen.stars.flux_e[rows], kind="stable")][:BRIGHTEST]
        pixel, flux = seen.stars.pixel_px[rows], seen.stars.flux_e[rows]
        known = [field for field in self._fields if field in self._databases]
        mirrored: tuple[Identification, CameraModel] | None = None
        if len(rows) < FEWEST:
            return failed("too_few", f"{len(rows)} usable detections; a pattern takes {FEWEST}"), self._camera(1.0)
        for field in [*known, *(one for one in self._fields if one not in self._databases)]:
            nominal = self.size_px[0] / (2.0 * np.tan(np.radians(field) / 2.0))
            focal, reach = (nominal, self._reach) if self.focal_px is None else (self.focal_px, 0.01)
            model = self._camera(focal)
            limit = 0.01 * float(np.hypot(*self.size_px))
            found = identify(
                pixel, model, self.database(field), flux=flux, focal_length_error=reach, tolerance_px=limit
            )
            if found.status == "inconsistent" or (found.ok and abs(found.scale - 1.0) > 1e-3):
                model = self._camera(focal * (found.scale if np.isfinite(found.scale) else 1.0))
                again = identify(
                    pixel, model, self.database(field), flux=flux, focal_length_error=0.02, tolerance_px=limit
                )
                found = again if again.ok else found
            if found.ok:
                if self.focal_px is None:
                    self.focal_px = model.value("focal_length_mm")
                return replace(found, detected=rows[found.detected]), model
            if found.status == "mirrored":
                mirrored = mirrored or (found, model)
            if self.focal_px is not None or found.status == "too_few":
                break
        return mirrored or (found, model)


def solve_all(names: Sequence[str], images: Sequence[SensorImage], solver: Solver, progress: Progress) -> list[Solved]:
    """Detect and identify, one line per frame."""
    out = []
    with progress.stage("frames solved", total=len(images)) as stage:
        for name, image in zip(names, images, strict=True):
            start = time.perf_counter()
            seen = detections(image)
            found, model = solver.identify(seen)
            residual = float("nan")
            if found.ok and found.residual_px is not None:
                residual = float(np.sqrt(np.mean(found.residual_px**2)))
            out.append(
                Solved(
                    name=name,
                    image=image,
                    seen=seen,
                    attitude=found.attitude.rotation if found.ok and found.attitude else None,
                    identified=len(found.detected),
                    residual_px=residual,
                    scale=model.value("focal_length_mm"),
                    words=found.message if not found.ok else "",
                    seconds=time.perf_counter() - start,
                )
            )
            progress.note(out[-1].line)
            stage.advance()
    return out


def matched(
    seen: Detections, direction: FloatArray, attitude: Rotation, model: CameraModel, radius_px: float
) -> tuple[IntArray, IntArray]:
    """Rows of the detections that can take part in a calibration, and of their stars."""
    rows = np.flatnonzero(seen.sane & seen.stars.fit)
    pairs = associate(seen.stars.pixel_px[rows], direction, attitude, model, radius_px=radius_px)
    return rows[pairs.detected], pairs.catalogue


def wahba(pixel_px: FloatArray, direction: FloatArray, model: CameraModel) -> Rotation:
    """Attitude of stars that all weigh the same."""
    solution = solve_wahba(model.unproject(pixel_px), np.array(direction))
    if not solution.ok:
        raise DomainError(f"attitude of {len(pixel_px)} stars: {solution.message}")
    return solution.rotation
