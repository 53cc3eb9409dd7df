"""Rendering and measurement of the star at all positions of its image; the map of the traced lens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.calibration.star_bench import StarBench
from calib.calibration.table_reduction import PoseData
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from experiments.laboratory.single_star.setup import build_bench, build_star, grid_px
from experiments.laboratory.single_star.star_readings import StarReadings, WindowPlan, read_windows
from experiments.laboratory.single_star.visits import Visits, visit
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import field_angles_deg
from optics.records import freeze, freeze_all
from optics.units import DEG_RAD
from render.engine.random import Streams
from render.forward import StarRenderer
from render.sensor_file.instrument import Instrument
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer

MAP_COLUMNS, MAP_ROWS = 33, 17
"""Points of the traced map over the detector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """A run on a table."""

    bench: StarBench  # True geometry
    visits: Visits  # Angles and directions
    bundle_px: FloatArray  # (n, 2) Truth: mean of the traced bundle at every position
    readings: StarReadings  # Centroids

    def __post_init__(self) -> None:
        freeze(self, "bundle_px", shape=(len(self.visits), 2))

    @property
    def pose_data(self) -> PoseData:
        """Positions and readings."""
        return PoseData(
            pixel_px=self.readings.position_px,
            covariance_px2=self.readings.covariance_px2,
            reading_rad=self.visits.reading_rad,
        )


def measure(
    config: SingleStarConfig,
    instrument: Instrument,
    table: TurntableConfig,
    streams: Streams,
    *,
    advance: Callable[[], None],
) -> Measurement:
    """Turn the table, render, read out."""
    camera, bench = instrument.camera, build_bench(config, table)
    wanted = grid_px(config, instrument)
    aimed = camera.nominal_direction(wanted[:, 0], wanted[:, 1], instrument.focal_length_mm)
    rolls = np.radians(table.rolls_deg)
    visits = visit(bench, wanted, aimed, rolls[np.arange(len(wanted)) % len(rolls)], streams, readings=config.frames)
    _check_field(visits, instrument)
    stars = build_star(config, instrument).field(visits.direction, instrument)
    advance()
    expected = StarRenderer(camera, exposure_s=instrument.config.exposure_s).render(stars)
    assert expected.truth is not None
    bundle = np.column_stack([expected.truth.bundle_x_px, expected.truth.bundle_y_px])
    _check_places(bundle, instrument, config.window_px)
    _check_spot(float(np.sqrt(np.max(expected.truth.variance_x_px2 + expected.truth.variance_y_px2))), config)
    advance()
    psfs = [row[0] for row in render_epsf(epsf_tracer(camera), stars, half_size_px=config.window_px // 2 + 1)]
    advance()
    plan = WindowPlan(size_px=config.window_px, frames=config.frames, dark_frames=config.dark_frames)
    readings = read_windows(expected, bundle, psfs, instrument, plan, streams=streams)
    advance()
    return Measurement(bench=bench, visits=visits, bundle_px=bundle, readings=readings)


@dataclass(frozen=True, slots=True, kw_only=True)
class TracedMap:
    """Landing points of the light of m directions by ray trace, without a model."""

    direction: FloatArray  # (m, 3) Unit vectors in cam
    pixel_px: FloatArray  # (m, 2) Photon-weighted mean of the traced bundle

    def __post_init__(self) -> None:
        freeze_all(self, direction=("m", 3), pixel_px=("m", 2))


def traced_map(config: SingleStarConfig, instrument: Instrument) -> TracedMap:
    """The camera's truth over the whole detector, for the light of the star simulator."""
    camera = instrument.camera
    x, y = (np.linspace(0, n - 1, c) for n, c in ((camera.width_px, MAP_COLUMNS), (camera.height_px, MAP_ROWS)))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    direction = camera.nominal_direction(grid[:, 0], grid[:, 1], instrument.focal_length_mm)
    field_x, field_y = field_angles_deg(direction)
    within = np.hypot(np.tan(field_x * DEG_RAD), np.tan(field_y * DEG_RAD)) <= np.tan(
        camera.lens.max_field_deg * DEG_RAD
    )
    direction = direction[within]
    pixel = Tracer(camera).bundle_means(build_star(config, instrument).field(direction, instrument))[:, 0]
    traced = np.isfinite(pixel).all(axis=1)
    return TracedMap(direction=direction[traced], pixel_px=pixel[traced])


def _check_field(visits: Visits, instrument: Instrument) -> None:
    lens = instrument.camera.lens
    v = visits.direction
    off_axis = np.degrees(np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2]))
    if off_axis.max() > lens.max_field_deg:
        at = int(np.argmax(off_axis))
        raise DomainError(
            f"place {at} needs the star at {off_axis[at]:.2f} deg from the axis; lens {lens.name!r} has a field of "
            f"{lens.max_field_deg:g} deg; raise grid.edge_px"
        )


def _check_places(place_px: FloatArray, instrument: Instrument, window_px: int) -> None:
    camera, half = instrument.camera, window_px // 2 + 1
    limit = np.array([camera.width_px, camera.height_px]) - 1
    inside = np.all((place_px >= half) & (place_px <= limit - half), axis=1)
    if not inside.all():
        at = int(np.argmin(inside))
        raise DomainError(
            f"the star is off the detector at {int((~inside).sum())} of {len(place_px)} places, first at column "
            f"{place_px[at, 0]:.0f}, row {place_px[at, 1]:.0f} of {camera.width_px} x {camera.height_px} px; raise "
            "grid.edge_px or lower setting_noise_arcsec"
        )


def _check_spot(radius_px: float, config: SingleStarConfig) -> None:
    if 4.0 * radius_px > config.window_px:
        raise DomainError(
            f"the star's image has an RMS radius of {radius_px:.1f} px, for which window_px = {config.window_px} is "
            f"too small (at least four RMS radii); come nearer to focus (instrument.defocus_mm = "
            f"{config.instrument.defocus_mm:g} mm) or enlarge the window"
        )
