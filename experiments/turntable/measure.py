"""Rendering and reading the star at every place that its image visits; the truth of the camera, traced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.laboratory.collimator import SingleStar
from experiments.laboratory.instrument import Instrument, build_instrument
from experiments.laboratory.readout.search import SEARCH_PX
from experiments.laboratory.turntable import Turntable, axis_directions, build_turntable
from experiments.laboratory.windows import StarReadings, WindowPlan, read_windows
from experiments.turntable.bench import Bench, Visits, visit
from experiments.turntable.settings import Config, TableConfig
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.frames import field_angles_deg
from optics.light.band import TopHat
from optics.light.spectrum import Blackbody
from optics.records import freeze
from optics.units import DEG_RAD
from render.engine.random import Streams
from render.forward import StarRenderer
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer

__all__ = [
    "Measurement",
    "TracedMap",
    "averaged",
    "build_bench",
    "build_star",
    "build_table",
    "camera_under_test",
    "check_table",
    "grid_px",
    "measure",
    "traced_map",
]


MAP_COLUMNS, MAP_ROWS = 33, 17
"""Points of the truth over the detector."""
LEAST_COVERAGE = 0.5
"""Of the width and of the height of the detector; below, a calibration says nothing about the rest of the field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TracedMap:
    """The truth of a camera: where the light of directions lands, by ray trace, without model.

    Attributes
    ----------
    direction : (m, 3)
        Unit vectors in cam.
    pixel_px : (m, 2)
        Photon-weighted mean of the traced bundle.
    """

    direction: FloatArray
    pixel_px: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "direction", shape=("m", 3), sizes=sizes)
        freeze(self, "pixel_px", shape=("m", 2), sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """One table's run.

    Attributes
    ----------
    bench : Bench
        As it really is.
    visits : Visits
        Angles and directions.
    bundle_px : (n, 2)
        Truth: mean of the traced bundle at every place.
    readings : StarReadings
        Centroids.
    """

    bench: Bench
    visits: Visits
    bundle_px: FloatArray
    readings: StarReadings

    def __post_init__(self) -> None:
        freeze(self, "bundle_px", shape=(len(self.visits), 2))


def camera_under_test(config: Config) -> Instrument:
    """The instrument, its lens axis beside the centre of the detector as configured."""
    instrument = build_instrument(config.instrument)
    camera = instrument.camera
    return replace(instrument, camera=replace(camera, centre_px=camera.centre_px + config.principal_point_px))


def build_star(config: Config) -> SingleStar:
    """The single-star simulator."""
    low, high = config.star.passband_nm
    return SingleStar(
        azimuth_deg=config.star.azimuth_deg,
        elevation_deg=config.star.elevation_deg,
        spectrum=Blackbody(temperature_k=config.star.temperature_k),
        band=TopHat(
            centre_nm=(low + high) / 2, width_nm=high - low, edge_nm=config.star.edge_nm, name="star simulator"
        ),
        signal_e=config.star.signal_e,
    )


def build_table(config: TableConfig, axes: str | None = None) -> Turntable:
    """The table of a configuration; other ``axes`` are what somebody believes of it."""
    return build_turntable(
        axes or config.axes,
        non_orthogonality_arcsec=_spread(config.non_orthogonality_arcsec),
        reading_noise_arcsec=_spread(config.reading_noise_arcsec),
        setting_noise_arcsec=config.setting_noise_arcsec,
        encoder_amplitude_arcsec=config.encoder_amplitude_arcsec,
        encoder_cycles=config.encoder_cycles,
    )


def check_table(key: str, config: TableConfig, count: int) -> None:
    """Refuse a table of another number of axes, or with a number of errors that does not fit to them.

    Raises
    ------
    ConfigError
        Naming the key.
    """
    try:
        directions = axis_directions(config.axes)
    except ConfigError as error:
        raise ConfigError(f"{key}.axes: {error}") from None
    found = len(directions)
    if found != count:
        raise ConfigError(f"{key}.axes = {config.axes!r}: {count} axes are needed, {found} given")
    for outer, inner in pairwise(directions):
        if abs(float(outer @ inner)) > 0.5:
            raise ConfigError(
                f"{key}.axes = {config.axes!r}: neighbouring axes are the same; they have to be square, like 'xy' or "
                "'xyz'"
            )
    for name, wanted in (("reading_noise_arcsec", count), ("non_orthogonality_arcsec", count - 1)):
        values = getattr(config, name)
        if len(values) not in (1, wanted):
            raise ConfigError(
                f"{key}.{name} = {list(values)}: {len(values)} values where {wanted} are needed, or one for all"
            )


def averaged(table: Turntable, readings: int) -> Turntable:
    """The table as the mean of several readings shows it: what is random in them averages out."""
    return replace(table, reading_noise_arcsec=table.reading_noise_arcsec / np.sqrt(readings))


def _spread(values: tuple[float, ...]) -> float | tuple[float, ...]:
    return values[0] if len(values) == 1 else values


def build_bench(config: Config, table: TableConfig) -> Bench:
    """Star, table and mounting."""
    return Bench(
        table=build_table(table),
        star=build_star(config).direction,
        installation=Rotation.from_rotvec(np.radians(config.installation_deg)),
    )


def grid_px(config: Config, instrument: Instrument) -> FloatArray:
    """Places (n, 2) that the image is to visit, row by row.

    Raises
    ------
    DomainError
        If they do not fit, or cover too little of the detector.
    """
    grid, camera = config.grid, instrument.camera
    size = np.array([camera.width_px, camera.height_px])
    reach = size - 1 - 2 * grid.edge_px
    if reach.min() < 0:
        raise DomainError(
            f"grid.edge_px = {grid.edge_px:g} px leaves nothing of a detector of {size[0]} x {size[1]} px; lower it"
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
    apart = min(np.diff(x).min(), np.diff(y).min())
    if apart < SEARCH_PX + config.window_px:  # one image holds the star at all places
        raise DomainError(
            f"{grid.columns} x {grid.rows} places lie {apart:.0f} px apart; at least {SEARCH_PX + config.window_px} px "
            "is needed: lower grid.columns or grid.rows"
        )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def measure(
    config: Config,
    instrument: Instrument,
    table: TableConfig,
    streams: Streams,
    *,
    advance: Callable[[], None],
) -> Measurement:
    """Turn, render, read.

    Parameters
    ----------
    config, instrument, table
        What to do, with which camera, on which table.
    streams : Streams
        Root of the noise of this run.
    advance : callable
        Called after each of four steps.

    Raises
    ------
    DomainError
        If the star leaves the detector or the field of the lens, is not seen or is saturated.
    """
    camera, bench = instrument.camera, build_bench(config, table)
    wanted = grid_px(config, instrument)
    aimed = camera.nominal_direction(wanted[:, 0], wanted[:, 1], instrument.focal_length_mm)
    rolls = np.radians(table.rolls_deg)
    visits = visit(bench, wanted, aimed, rolls[np.arange(len(wanted)) % len(rolls)], streams, readings=config.frames)
    _check_field(visits, instrument)
    stars = build_star(config).seen(visits.direction, instrument)
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


def _check_spot(radius_px: float, config: Config) -> None:
    if 4.0 * radius_px > config.window_px:
        raise DomainError(
            f"the star's image has an RMS radius of {radius_px:.1f} px, for which window_px = {config.window_px} is "
            f"too small (at least four RMS radii); come nearer to focus (instrument.defocus_mm = "
            f"{config.instrument.defocus_mm:g} mm) or enlarge the window"
        )


def traced_map(config: Config, instrument: Instrument) -> TracedMap:
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
    pixel = Tracer(camera).bundle_means(build_star(config).seen(direction, instrument))[:, 0]
    seen = np.isfinite(pixel).all(axis=1)
    return TracedMap(direction=direction[seen], pixel_px=pixel[seen])
