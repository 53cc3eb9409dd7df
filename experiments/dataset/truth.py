"""Truth of a frame: one row per star and band, flags for what disturbs it; the record of the frame."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.measure.centroid_error.cramer_rao_bound import flux_snr
from calib.measure.detection.footprints import footprint_bits, footprint_px, overlapping
from optics.arrays import FloatArray
from optics.frames import equatorial_deg

if TYPE_CHECKING:
    from render.records import Truth


@dataclass(frozen=True, slots=True)
class FileColumn:
    """A column of the truth."""

    name: str
    type: str
    unit: str  # In astropy's spelling
    description: str


COLUMNS = (
    FileColumn("frame", "int64", "", "number of the frame"),
    FileColumn(
        "star_id", "int64", "", "id in the catalogue (Gaia DR3 source_id, or -HIP); planets: -10^6 - NAIF number"
    ),
    FileColumn("catalogue_row", "int64", "", "row of the catalogue; -1 for planets"),
    FileColumn("band", "str", "", "pass band"),
    FileColumn("ra_deg", "float64", "deg", "right ascension of the direction in which the star is seen, icrs"),
    FileColumn("dec_deg", "float64", "deg", "declination of this direction, icrs"),
    FileColumn("magnitude", "float64", "mag", "magnitude in the catalogue; V of planets"),
    FileColumn("temperature_k", "float64", "K", "temperature of the black body that was rendered; NaN for planets"),
    FileColumn("chief_x_px", "float64", "pix", "column of the ray through the centre of the aperture stop"),
    FileColumn("chief_y_px", "float64", "pix", "row of this ray"),
    FileColumn("bundle_x_px", "float64", "pix", "column of the photon-weighted mean of all traced rays"),
    FileColumn("bundle_y_px", "float64", "pix", "row of this mean"),
    FileColumn("photon_x_px", "float64", "pix", "column of the centroid of all light, after charge diffusion"),
    FileColumn("photon_y_px", "float64", "pix", "row of this mean"),
    FileColumn("electrons_in", "float64", "electron", "electrons that the aperture stop alone would let in"),
    FileColumn("electrons", "float64", "electron", "expected electrons on the detector"),
    FileColumn(
        "electrons_vignetted", "float64", "electron", "electrons let in by the stop, blocked by other apertures"
    ),
    FileColumn("electrons_off_edge", "float64", "electron", "expected electrons off the detector or between chips"),
    FileColumn("electrons_hidden", "float64", "electron", "electrons lost behind a body in front of the star"),
    FileColumn(
        "electrons_absorbed", "float64", "electron", "electrons absorbed by surfaces and glasses in excess of the axis"
    ),
    FileColumn("electrons_scattered", "float64", "electron", "electrons scattered by the lens into a halo"),
    FileColumn("electrons_beyond", "float64", "electron", "electrons in omitted wings of the diffraction image"),
    FileColumn("variance_x_px2", "float64", "pix2", "second central moment of the ray bundle along the columns"),
    FileColumn("variance_y_px2", "float64", "pix2", "second central moment of the ray bundle along the rows"),
    FileColumn("snr", "float64", "", "signal-to-noise ratio of the flux by optimal weights"),
    FileColumn("smear_x_px", "float64", "pix", "motion of the chief ray from start to end of the exposure, columns"),
    FileColumn("smear_y_px", "float64", "pix", "motion of the chief ray from start to end of the exposure, rows"),
    FileColumn("flags", "int32", "", "sum of bits, see flag names"),
)

FLAGS = {
    "saturated": (1, "a pixel of its footprint is saturated"),
    "off_edge": (2, "more than 0.1 % of its light falls off the detector or between chips"),
    "blended": (4, "its footprint meets that of a star with at least 1 % of its electrons"),
    "defect": (8, "a pixel of its footprint is defective"),
    "cosmic_ray": (16, "a cosmic ray left charge in its footprint"),
    "vignetted": (32, "the lens transmits at least 1 % less of its light than on the axis"),
    "no_light": (64, "none of its light reaches the detector"),
    "hidden": (128, "a body hides it from the aperture or a part of it"),
}
"""Name -> (bit, meaning); footprints: `calib.measure.detection.footprints`."""

LOST_FRACTION = 1e-3
"""Fraction of a star's electrons off the detector (``off_edge``) or behind a body (``hidden``)."""
VIGNETTED_FRACTION = 0.01
"""Loss of transmission relative to the axis (``vignetted``)."""
BLEND_FRACTION = 0.01
"""Electrons of a neighbour relative to the star's (``blended``)."""
NO_LIGHT_FRACTION = 1e-6
"""Fraction of the entering electrons up to which a star counts as without light (``no_light``)."""
MARGIN_PX = 16.0
"""A star without light on the detector has a row if its chief ray is at most this far outside."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSources:
    """n point sources of the truth: stars in the order of the catalogue, then planets."""

    direction: FloatArray  # (n, 3) Unit vectors along icrs
    star_id: NDArray[np.int64]  # (n,)
    catalogue_row: NDArray[np.int64]  # (n,) -1 for planets
    magnitude: FloatArray  # (n,)
    temperature_k: FloatArray  # (n,) NaN for planets

    def __len__(self) -> int:
        return len(self.direction)


def pixel_flags(
    saturated: NDArray[np.bool_], defect: NDArray[np.bool_], hit: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Bits of single pixels (h, w)."""
    bits = saturated.view(np.uint8) * np.uint8(FLAGS["saturated"][0])
    bits |= defect.view(np.uint8) * np.uint8(FLAGS["defect"][0])
    if hit is not None:
        bits |= hit.view(np.uint8) * np.uint8(FLAGS["cosmic_ray"][0])
    return bits


def star_rows(
    sources: PointSources,
    truth: Truth,
    *,
    frame: int,
    band: str,
    blur_px: float,
    background_e2: float,
    bits: NDArray[np.uint8],
    smear_px: FloatArray,
    axial_transmission: float,
) -> dict[str, Any]:
    """Columns of the truth of a frame in one band.

    ``background_e2``: temporal variance of a pixel without starlight [e-^2]; ``bits`` (h, w): `pixel_flags`;
    ``smear_px`` (n, 2): motion of the chief rays; ``axial_transmission``: fraction of the light of a star on the axis
    that passes all apertures.
    """
    ra_deg, dec_deg = equatorial_deg(sources.direction)
    values = {name: getattr(truth, name)[:, 0] for name in type(truth).__dataclass_fields__}
    n = len(sources)
    electrons = values["electrons_image"]
    half_size_px = footprint_px(values["variance_x_px2"], values["variance_y_px2"], blur_px)
    columns = {
        "frame": np.full(n, frame, np.int64),
        "star_id": sources.star_id,
        "catalogue_row": sources.catalogue_row,
        "band": band,
        "ra_deg": ra_deg,
        "dec_deg": dec_deg,
        "magnitude": sources.magnitude,
        "temperature_k": sources.temperature_k,
        "electrons": electrons,
        "snr": flux_snr(electrons, values["noise_area_px2"], noise_e2=background_e2),
        "smear_x_px": smear_px[:, 0],
        "smear_y_px": smear_px[:, 1],
        "flags": _star_flags(values, half_size_px, bits, axial_transmission),
        **{name: value for name, value in values.items() if name != "electrons_image"},
    }
    chief_px = np.stack([values["chief_x_px"], values["chief_y_px"]])
    low_px = -0.5 - MARGIN_PX
    high_px = np.array(bits.shape[::-1])[:, None] - 0.5 + MARGIN_PX
    near_detector = ((chief_px >= low_px) & (chief_px <= high_px)).all(0)
    has_row = near_detector | (electrons > NO_LIGHT_FRACTION * values["electrons_in"])
    return {
        column.name: columns[column.name] if column.type == "str" else np.asarray(columns[column.name])[has_row]
        for column in COLUMNS
    }


def _star_flags(
    values: dict[str, FloatArray], half_size_px: FloatArray, bits: NDArray[np.uint8], axial_transmission: float
) -> NDArray[np.int32]:
    """Sums of bits (n,) of `FLAGS`; ``half_size_px`` (2, n): half sides of the footprints."""
    entering = values["electrons_in"]
    detected = values["electrons_image"]
    off_edge = values["electrons_off_edge"]
    transmitted = entering - values["electrons_vignetted"]
    no_light = ~(detected > NO_LIGHT_FRACTION * entering)
    flags = np.zeros(len(entering), np.int32)
    for name, flagged in (
        ("off_edge", off_edge > LOST_FRACTION * (off_edge + detected)),
        ("vignetted", transmitted < (1.0 - VIGNETTED_FRACTION) * axial_transmission * entering),
        ("hidden", values["electrons_hidden"] > LOST_FRACTION * entering),
        ("no_light", no_light),
    ):
        flags[flagged] |= FLAGS[name][0]
    centre_px = np.stack([values["photon_x_px"], values["photon_y_px"]])
    illuminated = np.flatnonzero(~no_light & np.isfinite(centre_px).all(0))
    centre_px, half_size_px = centre_px[:, illuminated], half_size_px[:, illuminated]
    flags[illuminated] |= footprint_bits(centre_px, half_size_px, bits)
    blended = overlapping(centre_px, half_size_px, detected[illuminated], BLEND_FRACTION)
    flags[illuminated[blended]] |= FLAGS["blended"][0]
    return flags


# --- Record of a frame, in its truth file and in the index


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskTruth:
    """The Moon or a planet that is larger than a pixel."""

    name: str
    kind: str  # ``moon`` or ``planet``, as in the labels
    star_id: int  # -10^6 - NAIF number
    ra_deg: float  # Apparent right ascension of the centre, ICRS
    dec_deg: float  # Apparent declination of the centre, ICRS
    x_px: float  # Column of the centre
    y_px: float  # Row of the centre
    diameter_px: float
    phase_deg: float  # Phase angle: Sun - body - observer
    sun_angle_deg: float  # Direction of the Sun in the image, from +column towards +row
    magnitude: float | None  # V; None where no published equation holds
    electrons: float  # Expected electrons on the detector
    photon_x_px: float  # Column of the centroid of these electrons
    photon_y_px: float  # Row of this centroid
    noise_share: float  # Squared numerical error of the image over photon variance, maximum over the pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameGhost:
    """A ghost: light of a source reflected by two surfaces; index n of n lens surfaces (0 to n - 1) is the detector."""

    source: str  # Identifier of a star, or name of a body
    back: int  # Surface of the first reflection, towards the sky
    forward: int  # Surface of the second reflection, towards the detector
    x_px: float  # Column of the centroid, on the detector or outside
    y_px: float  # Row of the centroid
    radius_px: float  # Radius of the uniform disk with the RMS radius of the ghost
    electrons: float  # Total
    peak_e: float  # Electrons in the brightest pixel
    sharp: bool  # Small enough to be detected as a star


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRecord:
    """One frame, in the units and conventions of files."""

    frame: int
    split: str  # train, validation, test or gap
    file: str  # Path of the frame, relative to the dataset's folder
    truth: str  # Path of its truth, relative to the dataset's folder
    ra_deg: float  # Right ascension of the boresight at mid-exposure
    dec_deg: float  # Declination of the boresight at mid-exposure
    roll_deg: float  # Position angle of the image's up direction (-row), north through east
    quat_xyzw: tuple[float, float, float, float]  # Attitude at mid-exposure: camera from ICRS, scalar last, w >= 0
    rate_deg_per_s: tuple[float, float, float]  # Angular velocity in camera axes at mid-exposure
    epoch_year: float  # Julian year
    exposure_s: float
    stars: int  # Number of stars with light on the detector
    saturated: int  # Number of these stars with a saturated pixel
    saturated_px: int  # Number of saturated pixels in the frame
    background_e: float  # Mean expected electrons per pixel of sky light
    frame_bytes: int  # Size of the frame's file
    sha256: str  # SHA-256 digest of the frame's file
    # The following are omitted from the text if empty
    disks: tuple[DiskTruth, ...] = ()
    ghosts: tuple[FrameGhost, ...] = ()
    layers_sha256: str = ""

    def to_text(self) -> str:
        """JSON on one line, keys in their order."""
        empty = {name for name in ("disks", "ghosts", "layers_sha256") if not getattr(self, name)}
        return json.dumps({name: value for name, value in asdict(self).items() if name not in empty})


def record_from_text(text: str) -> FrameRecord:
    """The record that `FrameRecord.to_text` wrote."""
    values = json.loads(text)
    for name in ("quat_xyzw", "rate_deg_per_s"):
        values[name] = tuple(values[name])
    values["disks"] = tuple(DiskTruth(**disk) for disk in values.get("disks", ()))
    values["ghosts"] = tuple(FrameGhost(**ghost) for ghost in values.get("ghosts", ()))
    return FrameRecord(**values)
