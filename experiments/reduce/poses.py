"""Own frames of a star on a turntable: a series is a pose, with the readings of the table; the joint calibration.

The methods turntable and fisher start from here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.calibration.record import Calibration
from calib.calibration.star_bench import StarBench, residual_px, star_direction
from calib.calibration.table_axes import TableAxes
from calib.calibration.table_reduction import (
    PoseData,
    calibrate_on_table,
    calibrated_bench,
    check_count,
    check_fit,
    check_parity,
)
from calib.cameras import BrownConrady, SensorGeometry
from calib.cameras.line_of_sight import line_of_sight_map
from calib.fitting.solution import LARGEST_RISE
from experiments.harness.quantities import Outcome
from experiments.harness.sections import Section, above, below, col, ratio_near
from experiments.harness.summary import Measured
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import SETTINGS_FILE, FolderLayout
from experiments.reduce.series import SeriesFrames, reduce_series
from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.units import ARCSEC_RAD

POSES = FolderLayout(needs=("outer_deg", "inner_deg"), same_scene="none", points=1, fewest=1)
"""Required keys of a folder of poses; a third axis has ``middle_deg`` too."""
KEYS = {2: ("outer_deg", "inner_deg"), 3: ("outer_deg", "middle_deg", "inner_deg")}
LEAST_COVERAGE = 0.5
FIT_ALARM = 6.334e-5  # 4 sigma
MAP_PX = 15
"""Grid points along a side of the detector for the mean error of the map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCalibration:
    """Joint calibration of camera, star, installation and axes from n poses."""

    series: tuple[SeriesFrames, ...]  # Poses
    data: PoseData  # Images and readings
    calibration: Calibration  # As estimated; inclinations of the axes are unknowns
    bench: StarBench  # Table, star and installation as calibrated

    @property
    def residual_px(self) -> FloatArray:
        """Images minus the calibration's prediction at the angles as read (n, 2)."""
        return residual_px(self.calibration.model, self.bench, self.data.pixel_px, self.data.reading_rad)

    @property
    def coverage(self) -> float:
        """Fraction of the detector's width or height spanned by the images, the smaller."""
        geometry = self.calibration.model.geometry
        return float((np.ptp(self.data.pixel_px, axis=0) / [geometry.width_px, geometry.height_px]).min())

    @property
    def map_error_arcsec(self) -> float:
        """Error of the line of sight over the detector by the covariance, RMS length, the best rotation removed."""
        geometry, model = self.calibration.model.geometry, self.calibration.model
        x, y = (np.linspace(0, n - 1, MAP_PX) for n in (geometry.width_px, geometry.height_px))
        pixel = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        covariance = self.calibration.covariance
        return line_of_sight_map(model, model.unproject(pixel), pixel, covariance=covariance).predicted_rms_arcsec


def calibrate_poses(folder: FrameFolder, methods: Sequence[str], use: Sequence[str]) -> PoseCalibration:
    """Joint calibration from the series of a folder with one of the uses."""
    s = folder.settings
    if s.table is None or s.pixel_pitch_um is None:
        missing = "[table]" if s.table is None else "pixel_pitch_um"
        raise ConfigError(f"{SETTINGS_FILE}: {missing} is missing; poses need both [table] and pixel_pitch_um")
    noise = s.table.reading_noise_arcsec
    table = TableAxes.create(s.table.axes, reading_noise_arcsec=noise)
    for pose in s.series:
        if (pose.middle_deg is not None) != (len(table.axis) == 3):
            raise ConfigError(
                f"{SETTINGS_FILE}, {pose.name}: axes = {s.table.axes!r} has {len(table.axis)} axes, a pose then has "
                f"the readings {', '.join(KEYS[len(table.axis)])}"
            )
    series = tuple(reduce_series(folder, frames, methods[:1]) for frames in folder.series if frames.settings.use in use)
    check_count(len(series), table, advice="give more poses")
    pitch_mm = s.pixel_pitch_um * 1e-3
    geometry = SensorGeometry(width_px=folder.width_px, height_px=folder.height_px, pixel_pitch_mm=pitch_mm)
    start = BrownConrady.create(geometry, focal_length_mm=pitch_mm / np.tan(s.pixel_arcsec * ARCSEC_RAD))
    star = star_direction(*s.table.star_deg)
    data = pose_data(series, table, methods[0])
    check_parity(data, table, start, star, key="axes in [table]")
    calibration = calibrate_on_table(data, table, start, leans=True, start_star=star)
    advice = (
        "the axes, the reading noise or star_deg in [table], pixel_arcsec or pixel_pitch_um are wrong, readings belong "
        "to other frames, or too little of the field is visited"
    )
    check_fit(calibration, f"{SETTINGS_FILE}, {len(series)} poses", advice)
    return PoseCalibration(
        series=series, data=data, calibration=calibration, bench=calibrated_bench(calibration, table)
    )


def pose_data(series: Sequence[SeriesFrames], table: TableAxes, method: str) -> PoseData:
    """Mean images with their covariance, and readings, of poses."""
    keys = KEYS[len(table.axis)]
    return PoseData(
        pixel_px=np.array([np.nanmean(pose.points.position_px[method], axis=0)[0] for pose in series]),
        covariance_px2=np.array([pose.mean_covariance_px2(method)[0] for pose in series]),
        reading_rad=np.radians([[getattr(pose.settings, key) for key in keys] for pose in series]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFit:
    """Whether residuals match their noise, and the detector is covered."""

    misfit: str  # In words
    flat: bool  # Whether the response of the pixels is known
    fit_ratio: Measured = col("Mean square of the residuals over its prediction")
    coverage: float = col("Fraction of the detector covered", format=".2f")
    # 1 where the covariance, which is of first order, describes the errors
    chi2_rise: float = col("Rise of χ² at one σ along the least determined direction", "", ".2f", shown=False)


def fit_record(poses: PoseCalibration, folder: FrameFolder) -> PoseFit:
    """Residuals of the calibration."""
    misfit = poses.calibration.solution.misfit
    degrees = max(misfit.degrees_of_freedom, 1)
    return PoseFit(
        misfit=str(misfit).capitalize(),
        flat=folder.flat is not None or folder.settings.prnu_fraction > 0.0,
        fit_ratio=Measured(value=misfit.value / degrees, uncertainty=float(np.sqrt(2.0 / degrees))),
        coverage=poses.coverage,
        chi2_rise=poses.calibration.solution.chi2_rise,
    )


def _fit_advice(outcome: Outcome) -> str:
    fit = outcome.result["fit"]
    if fit.fit_ratio.value < 1.0:
        return f"{fit.misfit}: the reading noise or read_noise_e is smaller than stated"
    more = "" if fit.flat else "; there is no flat, and prnu_fraction = 0 assumes equal response of all pixels"
    return (
        f"{fit.misfit}: the reading noise is larger than stated, the star or the table moved during a pose, or the "
        f"lens has more distortion than five terms describe{more}"
    )


FIT = Section(
    record=PoseFit,
    verdicts=[
        ratio_near(
            "fit_ratio",
            within=0.0,
            false_alarm=FIT_ALARM,
            title="calibration: mean square of the residuals over its prediction",
            advice=_fit_advice,
        ),
        above(
            "coverage",
            LEAST_COVERAGE,
            title="fraction of the detector's width and height covered by the star, the smaller",
            advice="the rest of the field is not calibrated: cover more of it",
        ),
        below(
            "chi2_rise",
            LARGEST_RISE,
            title="stated errors: rise of chi-square at one standard deviation, 1 where they hold",
            advice="the stated errors are of first order and do not hold: take finer readings or more of the field",
        ),
    ],
)
