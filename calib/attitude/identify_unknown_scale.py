"""Lost in space without a stated scale: fields of view are tried, and the first frame's scale narrows the next ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.attitude.identify import Identification, failed, identify
from calib.attitude.pattern_cache import SMALLEST_PATTERN, kept_database
from calib.cameras import BrownConrady, SensorGeometry
from optics.arrays import FloatArray

FIELDS_DEG = (11.0, 18.0, 7.0, 30.0, 4.5, 50.0, 2.9)
"""Widths of the field that are tried, the commonest of star cameras first; each reaches `FIELD_REACH` to both sides."""
FIELD_REACH, STATED_REACH, KNOWN_REACH, REFINED_REACH = 0.3, 0.06, 0.01, 0.02
"""Relative error of the focal length: of a tried field, of a stated one, of a known scale, of a proposed one."""
FEWEST, BRIGHTEST = 4, 80
"""Number of detections in a search."""
TOLERANCE_PART = 0.01
"""Distance of a match, over the diagonal: distortion is not known."""


class BlindIdentifier:
    """Identifies frames of one camera of unknown focal length.

    ``field_deg``: approximate field along the width [deg]; left out, ``fields_deg`` are tried. ``focal_px``: focal
    length of the first frame that was identified, or None.
    """

    def __init__(
        self, width_px: int, height_px: int, *, field_deg: float | None = None, fields_deg: Sequence[float] = FIELDS_DEG
    ) -> None:
        self.size_px = (width_px, height_px)
        self.focal_px: float | None = None
        self._fields = tuple(fields_deg) if field_deg is None else (field_deg,)
        self._reach = FIELD_REACH if field_deg is None else STATED_REACH
        self._databases: dict[float, Any] = {}

    def identify(self, pixel_px: FloatArray, flux: FloatArray) -> tuple[Identification, BrownConrady]:
        """Identify the brightest of the detections (n, 2) with fluxes (n,), and the pinhole that they were found with.

        A mirrored sky is returned as such only if no field gives an attitude.
        """
        if len(pixel_px) < FEWEST:
            return failed("too_few", f"{len(pixel_px)} usable detections; a pattern takes {FEWEST}"), self._pinhole(1.0)
        rows = np.argsort(-flux, kind="stable")[:BRIGHTEST]
        mirrored: tuple[Identification, BrownConrady] | None = None
        for field in sorted(self._fields, key=lambda field: field not in self._databases):
            result, model = self._in_field(pixel_px[rows], flux[rows], field)
            if result.ok:
                self.focal_px = self.focal_px or model.value("focal_length_mm")
                return result, model
            if result.status == "mirrored":
                mirrored = mirrored or (result, model)
            if self.focal_px is not None or result.status == "too_few":
                break
        return mirrored or (result, model)

    def _in_field(self, pixel: FloatArray, flux: FloatArray, field_deg: float) -> tuple[Identification, BrownConrady]:
        """Identification in fields around one; a proposed scale is tried in a second search."""
        database = self._database(field_deg)
        nominal = self.size_px[0] / (2.0 * np.tan(np.radians(field_deg) / 2.0))
        focal, reach = (nominal, self._reach) if self.focal_px is None else (self.focal_px, KNOWN_REACH)
        model, tolerance = self._pinhole(focal), TOLERANCE_PART * float(np.hypot(*self.size_px))
        result = identify(pixel, model, database, flux=flux, focal_length_error=reach, tolerance_px=tolerance)
        if result.status == "inconsistent" or (result.ok and abs(result.scale - 1.0) > 1e-3):
            model = self._pinhole(focal * (result.scale if np.isfinite(result.scale) else 1.0))
            refined = identify(
                pixel, model, database, flux=flux, focal_length_error=REFINED_REACH, tolerance_px=tolerance
            )
            result = refined if refined.ok else result
        return result, model

    def _pinhole(self, focal_px: float) -> BrownConrady:
        geometry = SensorGeometry(width_px=self.size_px[0], height_px=self.size_px[1], pixel_pitch_mm=1.0)
        return BrownConrady.create(geometry, focal_length_mm=focal_px)

    def _database(self, field_deg: float) -> Any:
        """Patterns for fields around one, kept on disk."""
        if field_deg not in self._databases:
            low, high = field_deg * SMALLEST_PATTERN, field_deg * (1.0 + self._reach)
            self._databases[field_deg] = kept_database(min_fov_deg=round(low, 2), max_fov_deg=round(high, 2))
        return self._databases[field_deg]
