"""From frames to a measured camera: blind solution, zenith, hot pixels, order of the model, measurement."""

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
from experiments.twin.faults import likely_fault, shape_fault
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
from experiments.twin.settings import TwinConfig
from experiments.twin.synthetic import RenderedNight
from optics.errors import DomainError
from render.sky.sky import Sky, load_sky

FEWEST_FOR_HOT = 3
FEWEST_FOR_SCALE = 12
"""Detections from which an unsolved frame is identified at any scale."""
COMPLETE_MAG = 1.2
"""Stars brighter than the limiting magnitude by this are all detected in a clear sky."""
CATALOGUE_MAG = 10.0
REFRACTIONS_ARCSEC = (20.0, 58.3, 90.0)
REFRACTION_RADIUS_PX = 1.2
DEFAULT_PITCH_MM, PITCH_TOLERANCE = 5e-3, 0.03


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredNight:
    """A night, solved and measured."""

    solutions: tuple[FrameSolution, ...]  # All frames of the folder
    prepared: PreparedNight  # Solved frames
    rows: tuple[int, ...]  # Their indices in ``solutions``
    orders: tuple[OrderValidation, ...]
    fit: CameraFit
    zenith: SiteZenith | None
    refraction_arcsec: tuple[float, float] | None  # Fitted amplitude and its standard deviation
    saturation_dn: float
    exposure_s: float
    pitch_mm: float
    taken: datetime | None
    notes: tuple[str, ...]


def black_level(config: TwinConfig, truth: RenderedNight | None) -> float | None:
    """Level of a dark frame of the same exposure, dark current included: as stated; of rendered frames the true one."""
    if truth is None:
        return config.camera.black_level_dn
    chip = truth.detector
    dark_e = chip.dark_current_e_per_s * chip.dark_factor(chip.dark_reference_c) * truth.exposure_s
    return float(chip.offset_dn + dark_e * chip.gain_dn_per_e)


def measure_night(
    frames: Sequence[NightFrame],
    config: TwinConfig,
    progress: Progress,
    *,
    truth: RenderedNight | None = None,
    notes: Sequence[str] = (),
) -> tuple[MeasuredNight, BlindIdentifier]:
    """Solve and measure the frames of one camera."""
    height, width = frames[0].image.dn.shape
    identifier = BlindIdentifier(width, height, field_deg=config.camera.field_deg if truth is None else truth.field_deg)
    solutions = solve_all([frame.name for frame in frames], [frame.image for frame in frames], identifier, progress)
    rows = [k for k, solution in enumerate(solutions) if solution.attitude is not None]
    if not rows:
        first = solutions[0]
        raise DomainError(f"none of {len(solutions)} frames could be identified; {first.name}: {likely_fault(first)}")
    unsolved = [solution for solution in solutions if solution.attitude is None]
    notes = [
        *notes,
        *(f"{solution.name}: {_other_camera(solution, identifier) or likely_fault(solution)}" for solution in unsolved),
    ]
    taken = [frames[k].taken for k in rows]
    sky = truth.sky if truth is not None else _sky(taken, notes)
    pitch = stated_pitch_mm(config, identifier.focal_px, notes) if truth is None else truth.detector.pixel_pitch_mm
    black = black_level(config, truth)
    with progress.stage("camera"):
        night, calibration = _first_night(
            [frames[k] for k in rows], [solutions[k] for k in rows], sky, pitch, identifier
        )
        night, calibration, zenith = _refracted(
            night, calibration, [frames[k].altitude_deg for k in rows], config, notes
        )
        hot = np.zeros((height, width), bool)
        if len(night) >= FEWEST_FOR_HOT:  # one or two frames would take stars for hot pixels
            hot = np.array(find_hot_pixels([frame.image for frame in night.frames]).mask)
        noise = noise_of(prepare(night, calibration, hot), range(len(night)), black)
        remeasured = []
        for frame in night.frames:
            image = with_noise(replace(frame.image, valid=frame.image.valid & ~hot), noise)
            remeasured.append(replace(frame, image=image, detected=detections(image)))
        prepared = prepare(replace(night, frames=tuple(remeasured)), calibration, hot)
        notes += _faults(prepared)
    with progress.stage("order of the camera model"):
        order, validations = choose_order(prepared, config.orders)
        if len(night) < 2:
            notes.append(
                "one frame: the order of the camera model cannot be cross-validated (one radial term is taken), and "
                "the twin has seen the frame that it is compared with"
            )
    with progress.stage("noise, PSF, light"):
        fit = measure_camera(prepared, order=order, used=range(len(night)), black_level_dn=black)
        refraction = _refraction(prepared, fit) if zenith is not None else None
    exposures = [frame.image.exposure_s for frame in frames if frame.image.exposure_s]
    exposure = config.camera.exposure_s or (float(np.median(exposures)) if exposures else 1.0)
    conversion = frames[0].image.conversion
    full = conversion.full / conversion.step if conversion is not None and conversion.full else None
    saturation = np.floor(full or max(float(frame.image.dn.max()) for frame in frames))
    measured = MeasuredNight(
        solutions=tuple(solutions),
        prepared=prepared,
        rows=tuple(rows),
        orders=tuple(validations),
        fit=fit,
        zenith=zenith,
        refraction_arcsec=refraction,
        saturation_dn=float(saturation if truth is None else truth.detector.largest_dn),
        exposure_s=exposure if truth is None else truth.exposure_s,
        pitch_mm=pitch,
        taken=next((time for time in taken if time), None),
        notes=tuple(notes),
    )
    return measured, identifier


def _other_camera(frame: FrameSolution, identifier: BlindIdentifier) -> str:
    """Note on an unsolved frame that is solved at another scale: another camera; "" otherwise."""
    if identifier.focal_px is None or frame.detected.usable.sum() < FEWEST_FOR_SCALE:
        return ""
    identification, focal = identify(frame.detected, BlindIdentifier(*identifier.size_px, fields_deg=FIELDS_DEG[:3]))
    if not identification.ok:
        return ""
    return (
        f"frames of two cameras: solved with {focal:.1f} px per radian, the other frames with "
        f"{identifier.focal_px:.1f}; left out. Folders of one camera and one focus are needed"
    )


def _faults(prepared: PreparedNight) -> list[str]:
    """Faults of frames that were solved nevertheless."""
    out = []
    for k, frame in enumerate(prepared.night.frames):
        shape = shape_fault(frame.image, frame.detected)
        if shape:
            out.append(f"{frame.name}: {shape}. The frame was solved nevertheless; the twin includes such images")
        stars = prepared.stars(k, prepared.camera, prepared.attitudes)
        bright = (stars.magnitude < prepared.limit_mag - COMPLETE_MAG) & prepared.camera.geometry.contains(
            stars.position_px
        )
        detected = (frame.detected.match(stars)[0] > 0.0)[bright]
        clouded = clouded_fraction(frame.image.dn.shape, stars.position_px[bright], detected)
        if clouded > 0.0:
            out.append(
                f"{frame.name}: clouds or an obstacle over about {100 * clouded:.0f} % of the frame: most of its "
                "bright stars are missing there. Attitude and camera remain valid; completeness and light are too low"
            )
    return out


def _sky(taken: Sequence[datetime | None], notes: list[str]) -> Sky:
    """Stars with aberration at the median time of the frames, if the frames have times."""
    times = sorted(time for time in taken if time is not None)
    if not times:
        notes.append(
            "no time in the frames' names or headers: stars at 2016.0 as seen from the barycentre (no aberration)"
        )
        return load_sky(faintest_mag=CATALOGUE_MAG)
    median_time = times[len(times) // 2]
    year = float(Time(median_time.replace(tzinfo=None), scale="utc").tdb.jyear)
    return load_sky(faintest_mag=CATALOGUE_MAG, epoch_year=year, observer="earth")


def stated_pitch_mm(config: TwinConfig, focal_px: float | None, notes: list[str]) -> float:
    """Pixel pitch: stated, or from a stated focal length; 5 um by default."""
    assert focal_px is not None
    stated, focal = config.camera.pixel_pitch_um, config.camera.focal_length_mm
    if stated is not None and focal is not None:
        measured_um = 1e3 * focal / focal_px
        if abs(measured_um / stated - 1.0) > PITCH_TOLERANCE:
            notes.append(
                f"wrong pitch: stars show {focal_px:.1f} px per radian; with focal_length_mm = {focal:g} that is a "
                f"pitch of {measured_um:.3g} um, pixel_pitch_um = {stated:g} is stated (binning?). Angles follow the "
                "stars"
            )
    if stated is not None:
        return stated * 1e-3
    if focal is not None:
        return focal / focal_px
    notes.append("neither pixel_pitch_um nor focal_length_mm is stated: lengths are in units of a pitch of 5 um")
    return DEFAULT_PITCH_MM


def _first_night(
    frames: Sequence[NightFrame],
    solutions: Sequence[FrameSolution],
    sky: Sky,
    pitch_mm: float,
    identifier: BlindIdentifier,
) -> tuple[SolvedNight, Calibration]:
    """Night without refraction, and its first camera."""
    assert identifier.focal_px is not None
    width, height = identifier.size_px
    geometry = SensorGeometry(width_px=width, height_px=height, pixel_pitch_mm=pitch_mm)
    camera = BrownConrady.create(geometry, focal_length_mm=identifier.focal_px * pitch_mm)
    attitudes = Rotation.concatenate([solution.attitude for solution in solutions if solution.attitude is not None])
    identified = []
    for frame, solution, attitude in zip(frames, solutions, attitudes, strict=True):
        star_rows = stars_about(sky, attitude, camera)
        identified.append(
            IdentifiedFrame(
                name=frame.name,
                image=frame.image,
                detected=solution.detected,
                zenith=None,
                rows=star_rows,
                direction=np.array(sky.direction[star_rows]),
                taken=frame.taken,
            )
        )
    night = SolvedNight(frames=tuple(identified), sky=sky)
    return night, first_camera(night, camera, attitudes)


def _refracted(
    night: SolvedNight,
    calibration: Calibration,
    altitude_deg: Sequence[float | None],
    config: TwinConfig,
    notes: list[str],
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
            boresight = attitudes_of(calibration).inv().apply([0.0, 0.0, 1.0])
            zenith = fit_zenith(boresight, np.array(altitudes), taken)
    if zenith is None:
        notes.append(
            "The zenith is unknown (site.latitude_deg and longitude_deg with times, or four altitudes, give it): "
            "refraction and extinction are not corrected; focal length and zero point include them."
        )
        return night, calibration, None
    night = night.refracted_towards(zenith.direction, site.refraction_arcsec)
    return night, first_camera(night, calibration.model, attitudes_of(calibration)), zenith


def _refraction(prepared: PreparedNight, fit: CameraFit) -> tuple[float, float]:
    """Refraction / tan z [arcsec] of least chi-square, by the same stars throughout, and its standard deviation."""
    zenith = np.stack([frame.zenith for frame in prepared.night.frames])  # type: ignore[misc]
    chi2, used_keys = [], None
    for arcsec in REFRACTIONS_ARCSEC:
        night = prepared.night.refracted_towards(zenith, arcsec)
        stars = gaussian_centroids(
            night, fit.camera, fit.attitudes, REFRACTION_RADIUS_PX, floor_px=fit.floor_px
        ).observations
        key = stars.frame * len(prepared.night.sky.magnitude) + stars.star
        if used_keys is None:
            used_keys = key[calibrate_order(stars, fit.camera, fit.order).used]
        calibration = calibrate_order(stars.select(np.isin(key, used_keys)), fit.camera, fit.order)
        chi2.append(calibration.solution.chi2)
    return chi_square_minimum(REFRACTIONS_ARCSEC, chi2, calibration.solution.degrees_of_freedom)
