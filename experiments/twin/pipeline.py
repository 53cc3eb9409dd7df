"""From frames to a measured camera: solution, zenith, hot pixels, order of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from astropy.time import Time
from numpy.typing import NDArray

from calib.calibration.record import Calibration
from calib.cameras import BrownConrady, SensorGeometry
from calib.measure.hot_pixels import find_hot_pixels
from experiments.harness.progress import Progress
from experiments.twin.camera import Order, Zenith, attitudes_of, fit_refraction, fit_zenith, zenith_of
from experiments.twin.camera import calibrated as calibrate_order
from experiments.twin.compare import star_heights
from experiments.twin.faults import clouded, shape_words, what_is_wrong
from experiments.twin.folder import NightFrame
from experiments.twin.measure import (
    CameraFit,
    Prepared,
    cross_validate,
    first_camera,
    gaussian_centroids,
    measure_camera,
    noise_of,
    prepare,
)
from experiments.twin.night import Frame, Night, field_stars, stars_about, with_noise
from experiments.twin.settings import Config
from experiments.twin.solve import FIELDS_DEG, Solved, Solver, detections, solve_all
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reduced:
    """A night, solved and measured."""

    solved: tuple[Solved, ...]  # All frames of the folder
    known: Prepared  # Those that were solved
    rows: tuple[int, ...]  # Their numbers among all
    orders: tuple[Order, ...]
    whole: CameraFit
    zenith: Zenith | None
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


def reduce_night(
    frames: Sequence[NightFrame],
    config: Config,
    progress: Progress,
    *,
    truth: KnownNight | None = None,
    notes: Sequence[str] = (),
) -> tuple[Reduced, Solver]:
    """Solve and measure the frames of one camera."""
    height, width = frames[0].image.dn.shape
    field = config.camera.field_deg if truth is None else _field_deg(truth)
    solver = Solver(width, height, field_deg=field)
    solved = solve_all([one.name for one in frames], [one.image for one in frames], solver, progress)
    solved = _again(solved, solver)
    rows = [k for k, one in enumerate(solved) if one.attitude is not None]
    _refuse_unsolved(solved, rows)
    words = [
        *notes,
        *(
            f"{one.name}: {_other_camera(one, solver) or what_is_wrong(one)}"
            for k, one in enumerate(solved)
            if k not in rows
        ),
    ]
    taken = [frames[k].taken for k in rows]
    sky = truth.sky if truth is not None else _sky(taken, words)
    pitch = _pitch_mm(config, solver, words) if truth is None else truth.detector.pixel_pitch_mm
    with progress.stage("camera"):
        night, made = _first(frames, solved, rows, sky, pitch, solver)
        night, made, zenith = _under_its_zenith(night, made, frames, rows, config, words)
        hot = _hot_pixels(night)
        known = prepare(night, made, hot)
        noise = noise_of(known, range(len(night)), black_level(config, truth))
        again = []
        for one in night.frames:
            image = with_noise(replace(one.image, valid=one.image.valid & ~hot), noise)
            again.append(replace(one, image=image, seen=detections(image)))
        known = prepare(replace(night, frames=tuple(again)), made, hot)
        words += _faults(known)
    with progress.stage("order of the camera model"):
        order, tried = cross_validate(known, config.orders)
        if len(night) < 2:
            words.append(
                "one frame: the order of the camera model cannot be cross-validated (one radial term is taken), and "
                "the twin has seen the frame that it is compared with"
            )
    with progress.stage("noise, PSF, light"):
        black = black_level(config, truth)
        whole = measure_camera(known, order=order.name, used=range(len(night)), black_level_dn=black)
        refraction = _refraction(known, whole) if zenith is not None else None
    exposures = [one.image.exposure_s for one in frames if one.image.exposure_s]
    exposure = config.camera.exposure_s or (float(np.median(exposures)) if exposures else 1.0)
    if truth is not None:
        exposure = truth.exposure_s
    conversion = frames[0].image.conversion
    full = conversion.full / conversion.step if conversion is not None and conversion.full else None
    highest = max(float(one.image.dn.max()) for one in frames)
    saturation = float(truth.detector.largest_dn) if truth is not None else float(np.floor(full or highest))
    return (
        Reduced(
            solved=tuple(solved),
            known=known,
            rows=tuple(rows),
            orders=tuple(tried),
            whole=whole,
            zenith=zenith,
            refraction_arcsec=refraction,
            saturation_dn=saturation,
            exposure_s=exposure,
            pitch_mm=pitch,
            taken=next((one for one in taken if one), None),
            notes=tuple(words),
        ),
        solver,
    )


def _again(solved: list[Solved], solver: Solver) -> list[Solved]:
    """Solve frames again that came before the scale was known."""
    if solver.focal_px is None:
        return solved
    out = []
    for first in solved:
        one = first
        if one.attitude is None:
            found, model = solver.identify(one.seen)
            if found.ok and found.attitude is not None:
                one = replace(
                    first,
                    attitude=found.attitude.rotation,
                    identified=len(found.detected),
                    scale=model.value("focal_length_mm"),
                    residual_px=float(np.sqrt(np.mean(found.residual_px**2)))
                    if found.residual_px is not None
                    else np.nan,
                    words="",
                )
        out.append(one)
    return out


def _other_camera(one: Solved, solver: Solver) -> str:
    """Whether a frame that the scale of the others does not solve is of another camera."""
    if solver.focal_px is None or one.seen.sane.sum() < FEWEST_FOR_OTHER:
        return ""
    found, model = Solver(*solver.size_px, fields_deg=FIELDS_DEG[:3]).identify(one.seen)
    if not found.ok:
        return ""
    focal = model.value("focal_length_mm")
    return (
        f"frames of two cameras: solved with {focal:.1f} px per radian, the other frames with "
        f"{solver.focal_px:.1f}; left out. Folders of one camera and one focus are needed"
    )


def _faults(known: Prepared) -> list[str]:
    """Faults of frames that were solved nevertheless."""
    out = []
    for k, frame in enumerate(known.night.frames):
        shape = shape_words(frame.image, frame.seen)
        if shape:
            out.append(f"{frame.name}: {shape}. The frame was solved nevertheless; the twin includes such images")
        stars = field_stars(known.night, k, known.camera, known.attitudes[k])
        sure = (stars.magnitude < known.limit_mag - SURE_MAG) & known.camera.geometry.contains(stars.place_px)
        share = clouded(frame.image, stars.place_px[sure], (star_heights(frame.seen, stars) > 0.0)[sure])
        if share > 0.0:
            out.append(
                f"{frame.name}: clouds or an obstacle over about {100 * share:.0f} % of the frame: most of its "
                "bright stars are missing there. Attitude and camera remain valid; completeness and light are too low"
            )
    return out


def _refuse_unsolved(solved: Sequence[Solved], rows: Sequence[int]) -> None:
    if not rows:
        first = solved[0]
        raise DomainError(f"none of {len(solved)} frames could be identified; {first.name}: {what_is_wrong(first)}")


def _field_deg(truth: KnownNight) -> float:
    edge = truth.camera.geometry.centre_px + np.array([[-truth.camera.geometry.width_px / 2, 0.0]])
    ray = truth.camera.unproject(edge)[0]
    return float(round(2.0 * np.degrees(np.arctan2(np.hypot(ray[0], ray[1]), ray[2])), 1))


def _sky(taken: Sequence[datetime | None], words: list[str]) -> Sky:
    """Stars as seen from the Earth in the middle of the night, if that is known."""
    known = [one for one in taken if one is not None]
    if not known:
        words.append(
            "no time in the frames' names or headers: stars at 2016.0 as seen from the barycentre (no aberration)"
        )
        return load_sky(faintest_mag=CATALOGUE_MAG)
    middle = sorted(known)[len(known) // 2]
    year = float(Time(middle.replace(tzinfo=None), scale="utc").tdb.jyear)
    return load_sky(faintest_mag=CATALOGUE_MAG, epoch_year=year, observer="earth")


def _pitch_mm(config: Config, solver: Solver, words: list[str]) -> float:
    """Pixel pitch: stated, or by a stated focal length; 5 um stand for one that is not known."""
    camera, focal_px = config.camera, solver.focal_px
    assert focal_px is not None
    stated, focal = camera.pixel_pitch_um, camera.focal_length_mm
    if stated is not None and focal is not None:
        shown = 1e3 * focal / focal_px
        if abs(shown / stated - 1.0) > 0.03:
            words.append(
                f"wrong pitch: stars show {focal_px:.1f} px per radian; with focal_length_mm = {focal:g} that is a "
                f"pitch of {shown:.3g} um, pixel_pitch_um = {stated:g} is stated (binning?). Angles follow the stars"
            )
    if stated is not None:
        return stated * 1e-3
    if focal is not None:
        return focal / focal_px
    words.append("neither pixel_pitch_um nor focal_length_mm is stated: lengths are in units of a pitch of 5 um")
    return 5e-3


def _first(
    frames: Sequence[NightFrame], solved: Sequence[Solved], rows: Sequence[int], sky: Sky, pitch: float, solver: Solver
) -> tuple[Night, Calibration]:
    """Night without refraction, and its first camera."""
    assert solver.focal_px is not None
    width, height = solver.size_px
    geometry = SensorGeometry(width_px=width, height_px=height, pixel_pitch_mm=pitch)
    camera = BrownConrady.create(geometry, focal_length_mm=solver.focal_px * pitch)
    made = []
    for k in rows:
        attitude = solved[k].attitude
        assert attitude is not None
        near = stars_about(sky, attitude, camera)
        made.append(
            Frame(
                name=frames[k].name,
                image=frames[k].image,
                seen=solved[k].seen,
                zenith=None,
                rows=near,
                direction=np.array(sky.direction[near]),
                taken=frames[k].taken,
            )
        )
    night = Night(frames=tuple(made), sky=sky, refraction_arcsec=0.0)
    return night, first_camera(night, camera, [solved[k].attitude for k in rows])


def _under_its_zenith(
    night: Night,
    made: Calibration,
    frames: Sequence[NightFrame],
    rows: Sequence[int],
    config: Config,
    words: list[str],
) -> tuple[Night, Calibration, Zenith | None]:
    """Refraction towards the zenith, where site or altitudes tell it."""
    taken = [one.taken for one in night.frames]
    zenith: Zenith | None = None
    site = config.site
    known = [one for one in taken if one is not None]
    altitude = [frames[k].altitude_deg for k in rows]
    if len(known) == len(taken):
        if site.latitude_deg is not None and site.longitude_deg is not None:
            zenith = Zenith(
                direction=zenith_of(site.latitude_deg, site.longitude_deg, known),
                latitude_deg=site.latitude_deg,
                longitude_deg=site.longitude_deg,
                error_deg=0.0,
            )
        elif all(one is not None for one in altitude):
            boresight = attitudes_of(made).inv().apply([0.0, 0.0, 1.0])
            zenith = fit_zenith(boresight, np.array(altitude, float), known)
    if zenith is None:
        words.append(
            "The zenith is unknown (site.latitude_deg and longitude_deg with times, or four altitudes, give it): "
            "refraction and extinction are not corrected; focal length and zero point include them."
        )
        return night, made, None
    night = night.under(zenith.direction, site.refraction_arcsec)
    return night, first_camera(night, made.model, list(attitudes_of(made))), zenith


def _hot_pixels(night: Night) -> NDArray[np.bool_]:
    """Pixels (h, w) above their neighbours in most of the frames; one or two frames would take stars for them."""
    if len(night) < FEWEST_FOR_HOT:
        return np.zeros(night.frames[0].image.dn.shape, bool)
    return np.array(find_hot_pixels([one.image for one in night.frames]).mask)


def _refraction(known: Prepared, whole: CameraFit) -> tuple[float, float]:
    """Amplitude that the frames themselves prefer."""
    chi2, freedom, kept = [], 1, None
    for arcsec in REFRACTIONS_ARCSEC:
        zenith = np.stack([one.zenith for one in known.night.frames])  # type: ignore[misc]
        night = known.night.under(zenith, arcsec)
        stars = gaussian_centroids(
            night, whole.camera, list(whole.attitudes), 1.2, floor_px=whole.floor_px
        ).observations
        if kept is None:
            made = calibrate_order(stars, whole.camera, whole.order)
            kept = set(zip(stars.frame[made.used].tolist(), stars.star[made.used].tolist(), strict=True))
        mine = np.array([pair in kept for pair in zip(stars.frame.tolist(), stars.star.tolist(), strict=True)])
        made = calibrate_order(stars.select(mine), whole.camera, whole.order)
        chi2.append(made.solution.chi2)
        freedom = made.solution.degrees_of_freedom
    return fit_refraction(REFRACTIONS_ARCSEC, chi2, freedom)
