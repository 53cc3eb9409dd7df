"""From frames to a measured camera: solution, zenith, hot pixels, order of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from astropy.time import Time
from scipy.spatial.transform import Rotation

from calib.attitude.identify_unknown_scale import FIELDS_DEG, BlindIdentifier
from calib.calibration.camera_order import OrderValidation, calibrate_order
from calib.calibration.record import Calibration
from calib.cameras import BrownConrady, SensorGeometry
from calib.detector.hot_pixels import find_hot_pixels
from calib.fitting.misfit import chi_square_minimum
from calib.measure.detection.limiting_magnitude import clouded_fraction
from calib.photometry.atmosphere import SiteZenith, fit_zenith, zenith_directions
from experiments.harness.progress import Progress
from experiments.twin.faults import likely_fault, shape_words
from experiments.twin.folder import NightFrame
from experiments.twin.measure import (
    CameraFit,
    PreparedNight,
    attitudes_of,
    choose_order,
    first_camera,
    gaussian_centroids,
    measure_camera,
    noise_of,
    prepare,
)
from experiments.twin.night import (
    FrameSolution,
    IdentifiedFrame,
    SolvedNight,
    detections,
    identify,
    solve_all,
    stars_about,
    with_noise,
)
from experiments.twin.settings import Config
from experiments.twin.synthetic import KnownNight
from optics.errors import DomainError
from render.sky.sky import Sky, load_sky

FEWEST_FOR_HOT = 3
FEWEST_FOR_OTHER = 12
"""Detections from which a frame is tried as one of another camera."""
SURE_MAG = 1.2
"""Magnitudes above the limit at which all stars are detected in clear sky."""
CATALOGUE_MAG = 10.0
REFRACTIONS_ARCSEC = (20.0, 58.3, 90.0)
REFRACTION_RADIUS_PX = 1.2
UNKNOWN_PITCH_MM, SAME_PITCH = 5e-3, 0.03


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredNight:
    """A night, solved and measured."""

    solved: tuple[FrameSolution, ...]  # All frames of the folder
    known: PreparedNight  # Those that were solved
    rows: tuple[int, ...]  # Their numbers among all
    orders: tuple[OrderValidation, ...]
    whole: CameraFit
    zenith: SiteZenith | None
    refraction_arcsec: tuple[float, float] | None  # Fitted amplitude and its standard deviation
    saturation_dn: float
    exposure_s: float
    pitch_mm: float
    taken: datetime | None
    notes: tuple[str, ...]


def black_level(config: Config, truth: KnownNight | None) -> float | None:
    """Level without light, as a dark frame of the same exposure shows it: as stated; of rendered frames the true one.

    Dark current belongs to it: PRNU acts on light alone.
    """
    if truth is None:
        return config.camera.black_level_dn
    chip = truth.detector
    dark_e = chip.dark_current_e_per_s * chip.dark_factor(chip.dark_reference_c) * truth.exposure_s
    return float(chip.offset_dn + dark_e * chip.gain_dn_per_e)


def measure_night(
    frames: Sequence[NightFrame],
    config: Config,
    progress: Progress,
    *,
    truth: KnownNight | None = None,
    notes: Sequence[str] = (),
) -> tuple[MeasuredNight, BlindIdentifier]:
    """Solve and measure the frames of one camera."""
    height, width = frames[0].image.dn.shape
    identifier = BlindIdentifier(width, height, field_deg=config.camera.field_deg if truth is None else truth.field_deg)
    solved = solve_all([frame.name for frame in frames], [frame.image for frame in frames], identifier, progress)
    rows = [k for k, solution in enumerate(solved) if solution.attitude is not None]
    if not rows:
        first = solved[0]
        raise DomainError(f"none of {len(solved)} frames could be identified; {first.name}: {likely_fault(first)}")
    unsolved = [solution for solution in solved if solution.attitude is None]
    words = [
        *notes,
        *(f"{solution.name}: {_other_camera(solution, identifier) or likely_fault(solution)}" for solution in unsolved),
    ]
    taken = [frames[k].taken for k in rows]
    sky = truth.sky if truth is not None else _sky(taken, words)
    pitch = stated_pitch_mm(config, identifier.focal_px, words) if truth is None else truth.detector.pixel_pitch_mm
    black = black_level(config, truth)
    with progress.stage("camera"):
        night, made = _first([frames[k] for k in rows], [solved[k] for k in rows], sky, pitch, identifier)
        night, made, zenith = _under_its_zenith(night, made, [frames[k].altitude_deg for k in rows], config, words)
        hot = np.zeros((height, width), bool)
        if len(night) >= FEWEST_FOR_HOT:  # one or two frames would take stars for hot pixels
            hot = np.array(find_hot_pixels([frame.image for frame in night.frames]).mask)
        noise = noise_of(prepare(night, made, hot), range(len(night)), black)
        again = []
        for frame in night.frames:
            image = with_noise(replace(frame.image, valid=frame.image.valid & ~hot), noise)
            again.append(replace(frame, image=image, detected=detections(image)))
        known = prepare(replace(night, frames=tuple(again)), made, hot)
        words += _faults(known)
    with progress.stage("order of the camera model"):
        order, tried = choose_order(known, config.orders)
        if len(night) < 2:
            words.append(
                "one frame: the order of the camera model cannot be cross-validated (one radial term is taken), and "
                "the twin has seen the frame that it is compared with"
            )
    with progress.stage("noise, PSF, light"):
        whole = measure_camera(known, order=order, used=range(len(night)), black_level_dn=black)
        refraction = _refraction(known, whole) if zenith is not None else None
    exposures = [frame.image.exposure_s for frame in frames if frame.image.exposure_s]
    exposure = config.camera.exposure_s or (float(np.median(exposures)) if exposures else 1.0)
    conversion = frames[0].image.conversion
    full = conversion.full / conversion.step if conversion is not None and conversion.full else None
    saturation = np.floor(full or max(float(frame.image.dn.max()) for frame in frames))
    measured = MeasuredNight(
        solved=tuple(solved),
        known=known,
        rows=tuple(rows),
        orders=tuple(tried),
        whole=whole,
        zenith=zenith,
        refraction_arcsec=refraction,
        saturation_dn=float(saturation if truth is None else truth.detector.largest_dn),
        exposure_s=exposure if truth is None else truth.exposure_s,
        pitch_mm=pitch,
        taken=next((time for time in taken if time), None),
        notes=tuple(words),
    )
    return measured, identifier


def _other_camera(frame: FrameSolution, identifier: BlindIdentifier) -> str:
    """Whether a frame that the scale of the others does not solve is of another camera."""
    if identifier.focal_px is None or frame.detected.usable.sum() < FEWEST_FOR_OTHER:
        return ""
    identification, focal = identify(frame.detected, BlindIdentifier(*identifier.size_px, fields_deg=FIELDS_DEG[:3]))
    if not identification.ok:
        return ""
    return (
        f"frames of two cameras: solved with {focal:.1f} px per radian, the other frames with "
        f"{identifier.focal_px:.1f}; left out. Folders of one camera and one focus are needed"
    )


def _faults(known: PreparedNight) -> list[str]:
    """Faults of frames that were solved nevertheless."""
    out = []
    for k, frame in enumerate(known.night.frames):
        shape = shape_words(frame.image, frame.detected)
        if shape:
            out.append(f"{frame.name}: {shape}. The frame was solved nevertheless; the twin includes such images")
        stars = known.stars(k, known.camera, known.attitudes)
        sure = (stars.magnitude < known.limit_mag - SURE_MAG) & known.camera.geometry.contains(stars.position_px)
        detected = (frame.detected.pairs(stars)[0] > 0.0)[sure]
        clouded = clouded_fraction(frame.image.dn.shape, stars.position_px[sure], detected)
        if clouded > 0.0:
            out.append(
                f"{frame.name}: clouds or an obstacle over about {100 * clouded:.0f} % of the frame: most of its "
                "bright stars are missing there. Attitude and camera remain valid; completeness and light are too low"
            )
    return out


def _sky(taken: Sequence[datetime | None], words: list[str]) -> Sky:
    """Stars as seen from the Earth in the middle of the night, if that is known."""
    known = [time for time in taken if time is not None]
    if not known:
        words.append(
            "no time in the frames' names or headers: stars at 2016.0 as seen from the barycentre (no aberration)"
        )
        return load_sky(faintest_mag=CATALOGUE_MAG)
    middle = sorted(known)[len(known) // 2]
    year = float(Time(middle.replace(tzinfo=None), scale="utc").tdb.jyear)
    return load_sky(faintest_mag=CATALOGUE_MAG, epoch_year=year, observer="earth")


def stated_pitch_mm(config: Config, focal_px: float | None, words: list[str]) -> float:
    """Pixel pitch: stated, or by a stated focal length; 5 um stand for one that is not known."""
    assert focal_px is not None
    stated, focal = config.camera.pixel_pitch_um, config.camera.focal_length_mm
    if stated is not None and focal is not None:
        shown = 1e3 * focal / focal_px
        if abs(shown / stated - 1.0) > SAME_PITCH:
            words.append(
                f"wrong pitch: stars show {focal_px:.1f} px per radian; with focal_length_mm = {focal:g} that is a "
                f"pitch of {shown:.3g} um, pixel_pitch_um = {stated:g} is stated (binning?). Angles follow the stars"
            )
    if stated is not None:
        return stated * 1e-3
    if focal is not None:
        return focal / focal_px
    words.append("neither pixel_pitch_um nor focal_length_mm is stated: lengths are in units of a pitch of 5 um")
    return UNKNOWN_PITCH_MM


def _first(
    frames: Sequence[NightFrame],
    solved: Sequence[FrameSolution],
    sky: Sky,
    pitch_mm: float,
    identifier: BlindIdentifier,
) -> tuple[SolvedNight, Calibration]:
    """Night without refraction, and its first camera."""
    assert identifier.focal_px is not None
    width, height = identifier.size_px
    geometry = SensorGeometry(width_px=width, height_px=height, pixel_pitch_mm=pitch_mm)
    camera = BrownConrady.create(geometry, focal_length_mm=identifier.focal_px * pitch_mm)
    attitudes = Rotation.concatenate([solution.attitude for solution in solved if solution.attitude is not None])
    identified = []
    for frame, solution, attitude in zip(frames, solved, attitudes, strict=True):
        near = stars_about(sky, attitude, camera)
        identified.append(
            IdentifiedFrame(
                name=frame.name,
                image=frame.image,
                detected=solution.detected,
                zenith=None,
                rows=near,
                direction=np.array(sky.direction[near]),
                taken=frame.taken,
            )
        )
    night = SolvedNight(frames=tuple(identified), sky=sky)
    return night, first_camera(night, camera, attitudes)


def _under_its_zenith(
    night: SolvedNight, made: Calibration, altitude_deg: Sequence[float | None], config: Config, words: list[str]
) -> tuple[SolvedNight, Calibration, SiteZenith | None]:
    """Refraction towards the zenith, where site or altitudes determine it."""
    site, zenith = config.site, None
    taken = [frame.taken for frame in night.frames if frame.taken is not None]
    altitudes = [altitude for altitude in altitude_deg if altitude is not None]
    if len(taken) == len(night):
        if site.latitude_deg is not None and site.longitude_deg is not None:
            zenith = SiteZenith(
                direction=zenith_directions(site.latitude_deg, site.longitude_deg, taken),
                latitude_deg=site.latitude_deg,
                longitude_deg=site.longitude_deg,
            )
        elif len(altitudes) == len(night):
            boresight = attitudes_of(made).inv().apply([0.0, 0.0, 1.0])
            zenith = fit_zenith(boresight, np.array(altitudes), taken)
    if zenith is None:
        words.append(
            "The zenith is unknown (site.latitude_deg and longitude_deg with times, or four altitudes, give it): "
            "refraction and extinction are not corrected; focal length and zero point include them."
        )
        return night, made, None
    night = night.under(zenith.direction, site.refraction_arcsec)
    return night, first_camera(night, made.model, attitudes_of(made)), zenith


def _refraction(known: PreparedNight, whole: CameraFit) -> tuple[float, float]:
    """Amplitude that the frames themselves prefer, by the same stars at every amplitude."""
    zenith = np.stack([frame.zenith for frame in known.night.frames])  # type: ignore[misc]
    chi2, used = [], None
    for arcsec in REFRACTIONS_ARCSEC:
        night = known.night.under(zenith, arcsec)
        stars = gaussian_centroids(
            night, whole.camera, whole.attitudes, REFRACTION_RADIUS_PX, floor_px=whole.floor_px
        ).observations
        key = stars.frame * len(known.night.sky.magnitude) + stars.star
        if used is None:
            used = key[calibrate_order(stars, whole.camera, whole.order).used]
        made = calibrate_order(stars.select(np.isin(key, used)), whole.camera, whole.order)
        chi2.append(made.solution.chi2)
    return chi_square_minimum(REFRACTIONS_ARCSEC, chi2, made.solution.degrees_of_freedom)
