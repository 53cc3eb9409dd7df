"""Expected electrons in, digital numbers out.

The order of effects, each from the EMVA 1288 description in `render.detector.spec`:

1. charge diffusion on the expectation (only where the renderer has not applied it; `render.detector.diffusion`);
   then smear, lag and blooming, where the detector has them (`render.detector.smear_lag`, `render.detector.full_well`);
2. response non-uniformity (PRNU) on all light, signal and background;
3. Poisson variate of (signal + background + dark current); the dark current has its own map (spread, hot pixels) and
   doubles with every ``dark_doubling_c``; then the charge of cosmic rays (`render.detector.cosmic_rays`), where any is
   given;
4. full well: charge beyond it is lost, the pixel is flagged (`render.detector.full_well`);
5. crosstalk (`render.detector.crosstalk`);
6. read noise, Gaussian, with its own standard deviation per pixel;
7. gain and non-linearity (`render.detector.nonlinearity`);
8. offset with pixel (DSNU) and column pattern;
9. round to the nearest whole number;
10. converter: clip to 0 ... 2^bits - 1; the upper end is flagged.

Quantum efficiency comes before all of it: the expectation is in electrons already.

Every random number is a function of (seed, band, source of noise, frame number, pixel index in the whole detector): a
window is the crop of the full frame bit for bit. Frames of different bands are independent though their numbers agree;
anything else that distinguishes exposures (target position, run) goes into ``streams.child(...)`` or the frame number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.errors import ConfigError, DomainError, unknown_name
from render.detector.cosmic_ray_charge import frame_deposit, window_deposit
from render.detector.cosmic_rays import CosmicRayHits
from render.detector.crosstalk import frame_neighbours, window_neighbours
from render.detector.diffusion import diffuse
from render.detector.full_well import bloomed
from render.detector.maps import full_maps, window_maps
from render.detector.smear_lag import with_lag, with_smear
from render.detector.spec import Detector
from render.engine import Engine
from render.engine.random import Streams
from render.engine.upload import uploaded
from render.records import ExpectedImage, Frame, WindowStack, checked_exposure

_INFINITY = np.float32(np.inf).view(np.uint32)
_EVERY = 8  # of the rows and columns that tell how bright an image is


def expose(
    expected: ExpectedImage | NDArray[Any],
    detector: Detector,
    *,
    streams: Streams,
    frame: int = 0,
    exposure_s: float | None = None,
    temperature_c: float | None = None,
    background_e_per_s: float = 0.0,
    band: str | None = None,
    hits: CosmicRayHits | None = None,
    before: ExpectedImage | NDArray[Any] | None = None,
) -> Frame:
    """Read out a frame.

    Parameters
    ----------
    expected : ExpectedImage or (h, w)
        Expected photo-electrons. A bare array is taken as diffused and as the expectation of this exposure.
    detector : Detector
        Must be of the same size.
    streams : Streams
        Root of the randomness.
    frame : int
        Frame number.
    exposure_s : float, optional
        Exposure time [s]; the image's own by default. A different one scales the image.
    temperature_c : float, optional
        Chip temperature [C]; the detector's reference by default.
    background_e_per_s : float
        Additional uniform light [e-/s per pixel].
    band : str, optional
        Which band of an image with several; for a bare array a label.
    hits : CosmicRayHits, optional
        Cosmic rays of this frame and detector.
    before : ExpectedImage or (h, w), optional
        Expected photo-electrons of the frame before, for a detector with lag; none if left out.

    Returns
    -------
    Frame
        Digital numbers, with what is saturated and defective.

    Raises
    ------
    DomainError
        Shapes that differ, negative or not finite electrons, exposure or background; hits of another detector.
    ConfigError
        No exposure time, or an unknown band.
    BackendError
        The backend is missing.
    """
    types = Engine.active().types
    electrons, band, exposure_s, factor = _expectation(expected, detector, band, exposure_s)
    if electrons.shape != detector.shape:
        raise DomainError(
            f"expected image of shape {electrons.shape} on detector {detector.name!r} of shape {detector.shape}; "
            "they must agree"
        )
    if detector.has_column_effects or before is not None:
        background_e = background_e_per_s * exposure_s
        light = with_smear(electrons.astype(float) * factor + background_e, detector, exposure_s)
        if before is not None:
            earlier, _, _, factor_before = _expectation(before, detector, band, exposure_s)
            if earlier.shape != detector.shape:
                raise DomainError(f"before has shape {earlier.shape}, the detector {detector.shape}; they must agree")
            light = with_lag(
                light, detector, with_smear(earlier.astype(float) * factor_before + background_e, detector, exposure_s)
            )
        electrons, factor, background_e_per_s = bloomed(light, detector).astype(np.float32), 1.0, 0.0
    maps = full_maps(detector, types)
    conditions = _conditions(
        detector,
        streams.child("readout", band),
        frames=(frame, 1),
        exposure_s=exposure_s,
        temperature_c=temperature_c,
        background_e_per_s=background_e_per_s,
        factor=factor,
        electrons=electrons,
    )
    from render.detector.chain import digitise

    packed = digitise(
        types,
        uploaded(types.Float32, electrons),
        maps=maps,
        neighbours=frame_neighbours(detector, types),
        detector=detector,
        conditions=conditions,
        deposit=None if hits is None else frame_deposit(types, hits, detector),
    )
    dn, saturated = _unpack(packed.reshape(detector.shape))
    return Frame(
        dn=dn,
        saturated=saturated,
        defect=np.asarray(maps.defect).reshape(detector.shape),
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        read_noise_e=detector.read_noise_e,
        exposure_s=exposure_s,
        band=band,
        index=frame,
    )


def expose_windows(
    stamps: ArrayLike,
    corner_px: ArrayLike,
    detector: Detector,
    *,
    streams: Streams,
    frames: int,
    exposure_s: float,
    first_frame: int = 0,
    temperature_c: float | None = None,
    background_e_per_s: float = 0.0,
    band: str = "",
    margin_px: int = 0,
    hits: Sequence[CosmicRayHits] | None = None,
) -> WindowStack:
    """Read windows of many frames out, all at once; other parameters and errors as of `expose`.

    Parameters
    ----------
    stamps : (n, h, w)
        Expected photo-electrons of each window, diffused, the same in every frame.
    corner_px : (n, 2)
        (column, row) on the detector of each stamp's first pixel.
    frames, first_frame : int
        Number of frames, at least 1; number of the first.
    margin_px : int
        Pixels on each side of the stamps that are only there for crosstalk and are cut off from the result. One pixel
        makes the windows equal to the crop of the full frame up to their borders. The margin may lie outside the
        detector.
    hits : sequence of CosmicRayHits, optional
        Cosmic rays of the whole detector, one set for each frame.

    Returns
    -------
    WindowStack
        Windows (h - 2 margin, w - 2 margin).
    """
    if detector.has_column_effects:
        raise ConfigError(
            f"detector {detector.name!r} has smear or blooming, which run along whole columns; read whole frames"
        )
    types = Engine.active().types
    electrons = _checked_electrons(stamps, "stamps", ndim=3)
    corner = _checked_corners(corner_px, electrons, detector, margin_px)
    if isinstance(frames, bool) or not isinstance(frames, int | np.integer) or frames < 1:
        raise DomainError(f"frames = {frames!r}; at least 1 frame is needed")
    if hits is not None and len(hits) != frames:
        raise DomainError(f"{len(hits)} sets of cosmic-ray hits for {frames} frames; one for each is needed")
    conditions = _conditions(
        detector,
        streams.child("readout", band),
        frames=(first_frame, int(frames)),
        exposure_s=exposure_s,
        temperature_c=temperature_c,
        background_e_per_s=background_e_per_s,
        electrons=electrons,
    )
    count, height, width = electrons.shape
    inner = (slice(margin_px, height - margin_px), slice(margin_px, width - margin_px))
    if electrons.size:
        from render.detector.chain import digitise

        column, row = corner[:, :1] + np.arange(width), corner[:, 1:] + np.arange(height)
        maps = window_maps(detector, types, column, row)
        packed = digitise(
            types,
            uploaded(types.Float32, electrons),
            maps=maps,
            neighbours=window_neighbours(detector, types, column, row),
            detector=detector,
            conditions=conditions,
            deposit=None if hits is None else window_deposit(types, hits, detector, column, row),
        )
        defect = np.array(maps.defect)
    else:  # no stars is a result too
        packed, defect = np.zeros((frames, 0), np.uint32), np.zeros(0, bool)
    dn, saturated = _unpack(packed.reshape(int(frames), count, height, width)[:, :, *inner])
    return WindowStack(
        dn=dn,
        saturated=saturated,
        defect=defect.reshape(electrons.shape)[:, *inner],
        corner_px=corner + margin_px,
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        read_noise_e=detector.read_noise_e,
        exposure_s=exposure_s,
        band=band,
        first_index=first_frame,
    )


def _expectation(
    expected: ExpectedImage | NDArray[Any], detector: Detector, band: str | None, exposure_s: float | None
) -> tuple[NDArray[np.float32], str, float, float]:
    """(electrons (h, w), band, exposure time, factor on the electrons)."""
    if not isinstance(expected, ExpectedImage):
        if exposure_s is None:
            raise ConfigError("exposure_s is missing; it is required with a plain array of electrons")
        return _checked_electrons(expected, "expected", ndim=2), band or "", checked_exposure(exposure_s), 1.0
    if band is None:
        if len(expected.band) != 1:
            raise ConfigError(f"band is missing; the image has {len(expected.band)}: {', '.join(expected.band)}")
        band = expected.band[0]
    if band not in expected.band:
        raise unknown_name("band", band, expected.band)
    electrons = np.ascontiguousarray(expected.electrons[:, :, expected.band.index(band)])
    if not expected.diffused and detector.diffusion_sigma_px > 0:
        electrons = diffuse(electrons, detector.diffusion_sigma_px)
    exposure_s = expected.exposure_s if exposure_s is None else checked_exposure(exposure_s)
    return electrons, band, exposure_s, exposure_s / expected.exposure_s


def _checked_electrons(values: ArrayLike, name: str, *, ndim: int) -> NDArray[np.float32]:
    try:
        electrons = np.ascontiguousarray(values, dtype=np.float32)
    except (TypeError, ValueError):
        raise DomainError(f"{name}: an array of electrons with {ndim} axes is needed") from None
    if electrons.ndim != ndim:
        raise DomainError(f"{name} has shape {electrons.shape}; {ndim} axes are needed")
    # one pass over the bits: a positive finite number has smaller bits than infinity
    if electrons.size and electrons.view(np.uint32).max() >= _INFINITY:
        lowest, highest = float(electrons.min()), float(electrons.max())
        if not (lowest >= 0.0 and highest < np.inf):  # NaN fails too
            bad = highest if lowest >= 0.0 else lowest
            raise DomainError(f"{name} contains {bad:g} e-; expectations are finite and not negative")
    return electrons


def _checked_corners(
    corner_px: ArrayLike, stamps: NDArray[Any], detector: Detector, margin_px: int
) -> NDArray[np.int64]:
    corner = np.asarray(corner_px)
    if corner.shape != (len(stamps), 2):
        raise DomainError(f"corner_px has shape {corner.shape} where ({len(stamps)}, 2) is needed for the stamps given")
    if corner.size and not np.issubdtype(corner.dtype, np.integer):
        raise DomainError(f"corner_px is of type {corner.dtype}; whole pixels are needed")
    size = np.array(stamps.shape[:0:-1], np.int64)
    if margin_px < 0 or np.any(size - 2 * margin_px < 1):
        raise DomainError(
            f"margin_px = {margin_px} px; stamps of {size[0]} x {size[1]} px must keep at least one pixel"
        )
    corner = corner.astype(np.int64).reshape(-1, 2)
    limit = np.array(detector.shape[::-1], np.int64)
    outside = np.any((corner + margin_px < 0) | (corner + size - margin_px > limit), axis=1)
    if outside.any():
        at = int(np.argmax(outside))
        raise DomainError(
            f"window {at} at column {corner[at, 0]}, row {corner[at, 1]} of {size[0]} x {size[1]} px is not inside "
            f"the detector of {limit[0]} x {limit[1]} px"
        )
    return corner


def _conditions(
    detector: Detector,
    streams: Streams,
    *,
    frames: tuple[int, int],
    exposure_s: float,
    temperature_c: float | None,
    background_e_per_s: float,
    electrons: NDArray[np.float32],
    factor: float = 1.0,
) -> Any:
    from render.detector.chain import ReadoutConditions

    exposure_s = checked_exposure(exposure_s)
    if not 0.0 <= background_e_per_s < np.inf:
        raise DomainError(f"background_e_per_s = {background_e_per_s:g} e-/s; it must be finite and not negative")
    temperature_c = detector.dark_reference_c if temperature_c is None else temperature_c
    some = electrons[..., ::_EVERY, ::_EVERY]
    return ReadoutConditions(
        signal_factor=factor,
        background_e=background_e_per_s * exposure_s,
        dark_factor_s=detector.dark_factor(temperature_c) * exposure_s,
        streams=streams,
        first_frame=frames[0],
        frames=frames[1],
        typical_e=factor * float(np.median(some)) if some.size else 0.0,
    )


def _unpack(packed: NDArray[np.uint32]) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Numbers and saturation flags of the words that `render.detector.chain` packs them into (bits 0-15, bit 16).

    Both are views on the little-endian words, whose third byte is the flag: the records copy them, and one pass over a
    frame of 8 megapixels is enough.
    """
    words = packed.astype("<u4", copy=False)[..., None]
    number, flag = words.view("<u2")[..., 0], words.view(np.uint8)[..., 2]
    return number, flag.view(np.bool_)  # a byte of 0 or 1 is a truth value


def mean_dark_frame(
    detector: Detector,
    frames: int,
    *,
    streams: Streams,
    exposure_s: float,
    temperature_c: float | None = None,
    band: str = "",
) -> NDArray[np.float32]:
    """Mean (h, w) [DN] of frames without light, numbered from 0; parameters as of `expose`."""
    dark, total = np.zeros(detector.shape, np.float32), np.zeros(detector.shape)
    for frame in range(frames):
        total += expose(
            dark, detector, streams=streams, frame=frame, exposure_s=exposure_s, temperature_c=temperature_c, band=band
        ).dn
    return np.asarray(total / frames, np.float32)
