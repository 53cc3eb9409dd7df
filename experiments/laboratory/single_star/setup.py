"""Camera, star, table and places of a configuration; checks before rendering."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.star_bench import StarBench, star_direction
from calib.calibration.table_axes import axis_directions
from calib.cameras import BrownConrady, SensorGeometry
from experiments.laboratory.bench.readout.search import SEARCH_PX
from experiments.laboratory.bench.signal import Signal, signal_of
from experiments.laboratory.devices.turntable import Turntable, build_turntable
from experiments.laboratory.settings.tables import SignalConfig
from experiments.laboratory.single_star.settings import SingleStarConfig, TurntableConfig
from experiments.laboratory.single_star.star import SingleStar
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.light.spectrum import Blackbody
from render.sensor_file.filters import open_band
from render.sensor_file.instrument import Instrument, build_instrument

START_ROUNDING = 0.05
"""Step of the start focal length, as a fraction of the paraxial focal length."""
LEAST_COVERAGE = 0.5
"""Least fraction of the width and of the height of the detector that the grid covers; a calibration does not
extrapolate."""


def camera_under_test(config: SingleStarConfig) -> Instrument:
    """The instrument, its lens axis off the centre of the detector as configured."""
    instrument = build_instrument(config.instrument)
    camera = instrument.camera
    return replace(instrument, camera=replace(camera, centre_px=camera.centre_px + config.principal_point_px))


def build_star(config: SingleStarConfig, instrument: Instrument) -> SingleStar:
    """The single-star simulator; its light fills the pass band of the camera."""
    band = open_band(config.passband, instrument, "star simulator")
    return SingleStar(
        azimuth_deg=config.star.azimuth_deg,
        elevation_deg=config.star.elevation_deg,
        spectrum=Blackbody(temperature_k=config.star.temperature_k),
        band=band,
        signal_e=star_signal(config, instrument).signal_e,
    )


def star_signal(config: SingleStarConfig, instrument: Instrument, brightness: SignalConfig | None = None) -> Signal:
    """Electrons of the simulated star, or of the same star at another brightness, and its magnitude."""
    band = open_band(config.passband, instrument, "star simulator")
    return signal_of(brightness or config.star, band, instrument, config.star.temperature_k)


def build_table(config: TurntableConfig, axes: str | None = None) -> Turntable:
    """The table of a configuration; ``axes``, if given, are the axes assumed by the reduction."""
    return build_turntable(
        axes or config.axes,
        non_orthogonality_arcsec=_spread(config.non_orthogonality_arcsec),
        reading_noise_arcsec=_spread(config.reading_noise_arcsec),
        setting_noise_arcsec=config.setting_noise_arcsec,
        encoder_amplitude_arcsec=config.encoder_amplitude_arcsec,
        encoder_cycles=config.encoder_cycles,
    )


def check_table(key: str, config: TurntableConfig, count: int) -> None:
    """Refuse a table with another number of axes, or a number of errors that does not match them."""
    try:
        directions = axis_directions(config.axes)
    except ConfigError as error:
        raise ConfigError(f"{key}.axes: {error}") from None
    if len(directions) != count:
        raise ConfigError(f"{key}.axes = {config.axes!r}: {count} axes are needed, {len(directions)} given")
    for outer, inner in pairwise(directions):
        if abs(float(outer @ inner)) > 0.5:
            raise ConfigError(
                f"{key}.axes = {config.axes!r}: neighbouring axes are the same; they must be orthogonal, like 'xy' or "
                "'xyz'"
            )
    for name, wanted in (("reading_noise_arcsec", count), ("non_orthogonality_arcsec", count - 1)):
        values = getattr(config, name)
        if len(values) not in (1, wanted):
            raise ConfigError(
                f"{key}.{name} = {list(values)}: {len(values)} values where {wanted} are needed, or one for all"
            )


def _spread(values: tuple[float, ...]) -> float | tuple[float, ...]:
    return values[0] if len(values) == 1 else values


def build_bench(config: SingleStarConfig, table: TurntableConfig) -> StarBench:
    """Star, table and mounting."""
    return StarBench(
        table=build_table(table),
        star=star_direction(config.star.azimuth_deg, config.star.elevation_deg),
        installation=Rotation.from_rotvec(np.radians(config.installation_deg)),
    )


def grid_px(config: SingleStarConfig, instrument: Instrument) -> FloatArray:
    """Grid (n, 2) of image positions, row by row."""
    grid, camera = config.grid, instrument.camera
    size = np.array([camera.width_px, camera.height_px])
    reach = size - 1 - 2 * grid.edge_px
    if reach.min() < 0:
        raise DomainError(
            f"grid.edge_px = {grid.edge_px:g} px leaves no area on a detector of {size[0]} x {size[1]} px; lower it"
        )
    counts = np.array([grid.columns, grid.rows])
    coverage = np.where(counts > 1, reach / size, 0.0)
    if coverage.min() < LEAST_COVERAGE:
        raise DomainError(
            f"{grid.columns} x {grid.rows} places at grid.edge_px = {grid.edge_px:g} px cover {coverage[0]:.0%} of the "
            f"detector's width and {coverage[1]:.0%} of its height; at least {LEAST_COVERAGE:.0%} of both is needed: "
            "lower grid.edge_px, raise grid.columns or grid.rows"
        )
    x, y = (np.linspace(grid.edge_px, n - 1 - grid.edge_px, c) for n, c in zip(size, counts, strict=True))
    pitch_px = min(np.diff(x).min(), np.diff(y).min())
    if pitch_px < SEARCH_PX + config.window_px:  # one image holds the star at all positions
        raise DomainError(
            f"{grid.columns} x {grid.rows} places lie {pitch_px:.0f} px apart; at least {SEARCH_PX + config.window_px} "
            "px is needed: lower grid.columns or grid.rows"
        )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def start_model(instrument: Instrument, focal_length_mm: float | None) -> BrownConrady:
    """Start camera from a data sheet: no distortion, principal point in the centre, f rounded."""
    camera = instrument.camera
    step = START_ROUNDING * instrument.focal_length_mm
    rounded = step * np.floor(instrument.focal_length_mm / step - 0.5)
    geometry = SensorGeometry(
        width_px=camera.width_px, height_px=camera.height_px, pixel_pitch_mm=camera.pixel_pitch_mm
    )
    return BrownConrady.create(geometry, focal_length_mm=float(rounded if focal_length_mm is None else focal_length_mm))
