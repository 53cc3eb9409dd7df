"""Chromatic error (ACC18 eq. 13-16, Table 1) of the centred lens and of a lens with one misaligned element.

The misalignment is solved for the published entry of Table 1 (`perturbation`). Results: the published statistic, the
shift of single points, the residual with a camera model for each band, other centroiders on the same frames, and the
shift of stars against ACC18's rule of one third (`stars`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib.accuracy.chromatic import (
    CALIBRATIONS,
    after_calibration,
    band_pairs,
    chromatic_error,
    independent_shifts,
    rms_shift_px,
    shifts,
    table1,
)
from experiments.chromatic.perturbation import ELEMENTS, MOVEMENT, RenderedMovement, solve_rendered_element
from experiments.chromatic.settings import ChromaticConfig
from experiments.chromatic.stars import STARS, StellarShifts, stellar_shift, stellar_shift_statistics
from experiments.harness.drawings import curves
from experiments.harness.plotting import INK, PALETTE, new_figure
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, agree, col, ratio_near
from experiments.harness.summary import measured
from experiments.laboratory.bench.centroid_methods import MethodLabels
from experiments.laboratory.bench.checks import check_light
from experiments.laboratory.bench.point_bench import Bench
from experiments.laboratory.bench.ray_prediction import bundle_prediction
from experiments.laboratory.bench.readout.windows import WindowReader
from experiments.laboratory.bench.signal import electrons_of_star, signal_of
from experiments.laboratory.chromatic_error import ChromaticMeasurement, measure_chromatic
from experiments.laboratory.devices.collimator import build_collimator
from experiments.laboratory.devices.collimator_effects import COLLIMATOR, collimator_shift
from experiments.laboratory.devices.target import CORNERS, corner_directions
from experiments.laboratory.settings.published import ACC18_ARCSEC, ACC18_TABLE1_PX, is_published_sensor
from optics.arrays import FloatArray
from optics.errors import unknown_name
from optics.light.band import Band
from optics.light.spectrum import Blackbody
from optics.rays.paraxial import chief_ray
from render.engine.random import Streams
from render.fits.files import write_frame
from render.records import Frame
from render.sensor_file.filters import interference_filters, open_band
from render.sensor_file.instrument import Instrument, build_instrument

NOISELESS_FALSE_ALARM = 1e-4
"""False-alarm probability of a normal distribution. The standard deviation is estimated from 36 points, so that the
probability by Student's t with 35 degrees of freedom is about 1e-3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensTest:
    """Frames and ray trace of one lens: p target positions, j points, b filters."""

    label: str
    bench: Bench
    instrument: Instrument
    frames: ChromaticMeasurement
    traced_px: FloatArray  # (p, j, b, 2) By the NumPy ray trace, independent of frames and renderer

    @property
    def method(self) -> str:
        """The main centroider."""
        return self.bench.methods[0]

    def shift_px(self, position_px: FloatArray) -> FloatArray:
        """Shifts (pair, p, j, 2) of positions (p, j, b, 2), eq. 15."""
        return np.stack(list(shifts(position_px, self.bench.pairs).values()))

    @property
    def measured_px(self) -> tuple[FloatArray, FloatArray]:
        """Shifts (pair, p, j, 2) of the frames, and their standard deviations."""
        sigma = self.frames.shift_sigma(self.bench.pairs, self.method)
        return self.shift_px(self.frames.mean_px[self.method]), np.stack(list(sigma.values()))

    @property
    def table1_px(self) -> tuple[FloatArray, FloatArray]:
        """Entries (pair, 2) of Table 1 (eq. 16), and their standard deviations."""
        sigma = self.frames.table1_sigma(self.bench.pairs, self.method)
        return table1(self.measured_px[0]), np.stack(list(sigma.values()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Table1Entries:
    """ACC18's Table 1 (eq. 16: signed mean of the shifts, halved) of a lens."""

    label: str
    measured_px: Any = col("Frames", "px", dims="pair axis")
    predicted_px: FloatArray = col("Ray trace", "px", ".5f", "pair axis")
    # Centre of gravity of the noiseless pixels; uncertainty: scatter from point to point by pixel phase
    noiseless_pixels_px: Any = col("Noiseless pixels", "px", dims="pair axis", shown=False)
    published_px: FloatArray | None = col("Published", "px", ".4f", "pair axis", default=None)
    rms_shift_px: FloatArray = col("RMS shift of a point", "px", ".3f", "pair axis")
    frames_per_entry: int = col("Frames per entry", shown=False)
    lsfe_arcsec: Any = col("Chromatic LSFE, 3 σ", "arcsec", dims="axis", shown=False)
    published_lsfe_arcsec: Sequence[float] | None = col("Published", "arcsec", dims="axis", shown=False, default=None)
    mean_squared_pull: Any = col("Squared deviation of a shift over its variance", shown=False)


def table1_entries(lens: LensTest, *, published: bool) -> Table1Entries:
    """Table 1 with its published values, LSFE-S, and the chi-square per degree of freedom of single shifts."""
    shift_px, sigma_px = lens.measured_px
    traced_px = lens.shift_px(lens.traced_px)
    entry_px, entry_sigma_px = lens.table1_px
    frames_per_entry = lens.bench.frames * shift_px[0, ..., 0].size
    term = chromatic_error(entry_px, entry_sigma_px, lens.instrument.pixel_arcsec, frames_per_entry)
    pulls = (shift_px - traced_px) / sigma_px
    entries = Table1Entries(
        label=lens.label,
        measured_px=measured(entry_px, entry_sigma_px),
        predicted_px=table1(traced_px),
        noiseless_pixels_px=measured(*_noiseless_table1(lens)),
        rms_shift_px=np.stack([rms_shift_px(pair_shift_px) for pair_shift_px in shift_px]),
        frames_per_entry=frames_per_entry,
        lsfe_arcsec=measured(term.arcsec, term.uncertainty_arcsec, term.n, "arcsec"),
        mean_squared_pull=measured(float((pulls**2).mean()), np.sqrt(2.0 / _effective_dof(lens, sigma_px))),
    )
    if not published:
        return entries
    published_px = [ACC18_TABLE1_PX.get(pair, (np.nan, np.nan)) for pair in lens.bench.pair_names]
    return replace(entries, published_px=np.array(published_px), published_lsfe_arcsec=ACC18_ARCSEC["LSFE-S"])


def _effective_dof(lens: LensTest, sigma_px: FloatArray) -> float:
    """Degrees of freedom of the mean of the squared pulls.

    Two pairs share the reference band: their shifts correlate by rho = 1/2, their squares by rho^2 = 1/4, and k pairs
    count as k / (1 + (k - 1) / 4). Points of a position share the motion of the target (`independent_shifts`).
    """
    point_count = sigma_px.shape[2]
    independent = independent_shifts(sigma_px.size, point_count, lens.frames.common_mean_px, sigma_px)
    return independent / (1.0 + (len(lens.bench.pairs) - 1) / 4.0)


def _noiseless_table1(lens: LensTest) -> tuple[FloatArray, FloatArray]:
    """Table 1 (pair, 2) by centres of gravity of noiseless pixels; its standard deviation by pixel sampling.

    The sampling error (centre of gravity minus ray trace) of n points at different pixel phases is independent from
    point to point; Table 1 is half of a mean, hence sigma / (2 sqrt(n)).
    """
    noiseless_px = lens.shift_px(lens.frames.pixels_px)
    sampling_error_px = (noiseless_px - lens.shift_px(lens.traced_px)).reshape(len(lens.bench.pairs), -1, 2)
    points = sampling_error_px.shape[1]
    return table1(noiseless_px), sampling_error_px.std(1, ddof=1) / (2.0 * np.sqrt(points))


def field_map(outcome: Outcome, pairs: Sequence[str] = ()) -> Figure:
    """Shift of every point over the field, a column per lens, a row per pair; ray trace in grey under the frames."""
    shown = list(pairs) or outcome.names("pair")
    lenses = outcome.labels("lens")
    camera = outcome.result["bench"].instrument.camera
    figure, grid = new_figure(
        len(shown), len(lenses), aspect_ratio=0.27 * len(shown) + 0.06, sharex=True, sharey=True, squeeze=False
    )
    for row, pair, colour in zip(grid, shown, PALETTE, strict=False):
        for panel, (lens, label) in zip(row, lenses.items(), strict=True):
            nominal = outcome.values("nominal_px", lens=lens)
            shift, traced = (
                outcome.values(f"{kind}_shift_px", lens=lens, pair=pair) for kind in ("measured", "predicted")
            )
            longest = float(np.hypot(*shift.T).max())
            style = {"angles": "xy", "scale_units": "xy", "scale": longest / (1.2 * outcome.config.target.pitch_px)}
            panel.quiver(*nominal.T, *traced.T, color="#c3c8ce", width=0.009, headwidth=3, **style)
            panel.quiver(*nominal.T, *shift.T, color=colour, width=0.0035, headwidth=4, **style)
            scale_bar_px = float(f"{longest:.0e}")  # one significant digit
            x, y = (0.58 * camera.width_px, 0.5 * camera.height_px)
            panel.quiver(x, y, scale_bar_px, 0, color=INK, width=0.0045, **style)
            panel.text(x, y - 0.06 * camera.height_px, f"{scale_bar_px:g} px", fontsize=8)
            draw_detector_edge(panel, outcome.result["bench"].instrument)
            panel.set_title(f"{pair} nm, {label}")
        row[0].set_ylabel("row [px]")
    for panel in grid[-1]:
        panel.set_xlabel("column [px]")
    return figure


def draw_detector_edge(panel: Any, instrument: Instrument) -> None:
    """Edge of the detector and seams between its chips; row 0 is at the top."""
    chip = instrument.detector
    size = np.array([instrument.camera.width_px, instrument.camera.height_px])
    x, y = ((-0.5, end - 0.5) for end in size)
    panel.plot([x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], color="#8a9099", linewidth=0.8)
    for seam in range(1, chip.chips):
        panel.axvline(seam * (chip.chip_width_px + chip.gap_px) - 0.5, color="#c3c8ce", linewidth=0.8)
    margin = 0.03 * size.max()
    panel.set(xlim=(-margin, size[0] + margin), ylim=(size[1] + margin, -margin), aspect="equal")
    panel.grid(visible=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class PointShifts:
    """Shift of every target point (eq. 15), position after position."""

    nominal_px: FloatArray = col("Nominal", "px", dims="point axis")
    measured_shift_px: Any = col("Frames", "px", dims="pair point axis")
    noiseless_pixels_shift_px: FloatArray = col("Noiseless pixels", "px", dims="pair point axis")
    predicted_shift_px: FloatArray = col("Ray trace", "px", dims="pair point axis")


def tabulate_point_shifts(lens: LensTest) -> PointShifts:
    """Frames, noiseless pixels and ray trace at the points of all positions."""
    shift_px, sigma_px = lens.measured_px
    pair_point_axis = (len(shift_px), -1, 2)
    return PointShifts(
        nominal_px=lens.frames.nominal_px.reshape(-1, 2),
        measured_shift_px=measured(shift_px.reshape(pair_point_axis), sigma_px.reshape(pair_point_axis)),
        noiseless_pixels_shift_px=lens.shift_px(lens.frames.pixels_px).reshape(pair_point_axis),
        predicted_shift_px=lens.shift_px(lens.traced_px).reshape(pair_point_axis),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResiduals:
    """RMS length of the shift of a point, as measured and with parameters of the camera model per band."""

    residual_px: FloatArray = col("RMS", "px", ".3f", "pair step")
    traced_residual_px: FloatArray = col("Ray trace", "px", ".3f", "pair step", shown=False)


def calibrate_bands(lens: LensTest) -> CalibrationResiduals:
    """Residuals with a principal point per band, a focal length per band, and both."""
    from_centre = lens.frames.nominal_px - lens.instrument.camera.centre_px

    def rms(shift_px: FloatArray) -> FloatArray:
        residuals = [after_calibration(pair_shift, from_centre).values() for pair_shift in shift_px]
        return np.array([[np.hypot(*rms_shift_px(residual)) for residual in steps] for steps in residuals])

    traced_px = lens.shift_px(lens.traced_px)
    return CalibrationResiduals(residual_px=rms(lens.measured_px[0]), traced_residual_px=rms(traced_px))


@dataclass(frozen=True, slots=True, kw_only=True)
class CentroiderComparison:
    """Results of every centroider on the same frames; NaN where it does not converge for some point."""

    noise_px: FloatArray = col("Noise", "px", ".4f", "method")
    rms_error_px: FloatArray = col("RMS error", "px", ".4f", "method")
    mean_shift_px: FloatArray = col("Mean shift", "px", ".4f", "method pair")  # Along `DecentreConfig.axis`
    table1_px: FloatArray = col("Table 1", "px", ".4f", "method pair axis", shown=False)


def compare_centroiders(lens: LensTest, axis: int) -> CentroiderComparison:
    """Noise of a frame, error of the mean centroid against the centroid of all light, Table 1, by centroider."""
    frames = lens.frames
    methods = lens.bench.methods
    table1_px = np.array([table1(lens.shift_px(frames.mean_px[method])) for method in methods])
    error_px = [frames.mean_px[method] - frames.photon_px for method in methods]
    return CentroiderComparison(
        noise_px=np.array([np.sqrt((frames.sigma_px[method] ** 2).mean()) for method in methods]),
        rms_error_px=np.sqrt([(method_error_px**2).mean() for method_error_px in error_px]),
        mean_shift_px=table1_px[..., axis],
        table1_px=table1_px,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchConditions:
    """Instrument and light of the measurement."""

    instrument: Instrument
    frame: Frame  # Full frame, first position, reference filter
    signal_e: float = col("Signal", "e-", ".0f")
    signal_star: str = col("Star")
    v7_5_star_e: float = col("Star of V = 7.5", "e-", ".0f")
    pixel_arcsec: float = col("Angle of a pixel", "arcsec", ".2f")
    rms_spot_um: FloatArray = col("RMS spot radius", "um", ".1f", "band")
    reference_k: float = col("Reference star", "K", ".0f")
    temperature_k: FloatArray = col("Temperature", "K", ".0f", "temperature_k")


def axes(config: ChromaticConfig) -> Quantities:
    """Dimensions that all sections share."""
    quantities = Quantities()
    centres_nm = config.filters.centres_nm
    pairs = band_pairs(centres_nm, centres_nm.index(config.filters.reference_nm))
    quantities.axis("pair", [name for name, _, _ in pairs], "Bands", unit="nm")
    quantities.axis("axis", ["x", "y"], "Axis", names=["X", "Y"])
    labels = MethodLabels(matched="PSF of each filter", reference="PSF of the reference filter")
    quantities.axis("method", list(config.methods), "Centroider", names=labels)
    steps = [step.replace(" ", "_") for step in CALIBRATIONS]
    quantities.axis("step", steps, "Calibration", names=["as measured", *list(CALIBRATIONS)[1:]])
    quantities.axis("band", [f"{centre:g}" for centre in centres_nm], "Band", unit="nm")
    quantities.axis("point", np.arange(len(CORNERS) * config.target.rows * config.target.columns) + 1, "Target point")
    quantities.axis("temperature_k", config.stars.temperatures_k, "Effective temperature", unit="K", format=".0f")
    return quantities


def _lens_axis(quantities: Quantities, lenses: Sequence[Table1Entries]) -> None:
    quantities.axis("lens", ["centred", "moved"], "Lens", names=[lens.label for lens in lenses])


def build_bench(config: ChromaticConfig, instrument: Instrument, signal_e: float) -> tuple[Bench, FloatArray]:
    """Bench and unit vectors (p, j, 3) of the target points; all checks that need no rendering."""
    filters = interference_filters(config.filters)
    bench = Bench(
        target=config.target,
        lamp=Blackbody(temperature_k=config.lamp_k),
        filters=filters,
        reference=config.filters.centres_nm.index(config.filters.reference_nm),
        signal_e=signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=config.methods,
        collimator=build_collimator(config.collimator, filters),
    )
    instrument.camera.lens.check_glass()
    chief_ray(instrument.camera.focused_lens, 1.0)  # refuses a lens that is not centred
    for band in bench.filters:
        instrument.check_band("filters.centres_nm", band)
    if config.pair not in bench.pair_names:
        raise unknown_name("decentre.pair", config.pair, bench.pair_names)
    if config.decentre.element != "auto":
        instrument.camera.lens.indices_of(config.decentre.element)
    direction = corner_directions(config.target, instrument)
    check_light(bench, instrument, direction)
    return bench, direction


def run(config: ChromaticConfig, *, progress: Progress) -> dict[str, Any]:
    """Solve the misalignment; render, read out and reduce both lenses; trace the expected shifts."""
    instrument = build_instrument(config.instrument)
    passband = open_band(config.passband, instrument, "full pass band")
    signal = signal_of(config, passband, instrument, config.stars.reference_k)
    bench, direction = build_bench(config, instrument, signal.signal_e)
    axis = "xy".index(config.decentre.axis)
    solutions, rendered = solve_rendered_element(config, bench, instrument, direction, progress)
    perturbed = build_instrument(config.instrument, rendered.apply(instrument.camera.lens, axis))
    streams = Streams(config.seed).child("chromatic")
    lenses = []
    for name, label, stage_label, camera in (
        ("centred", "centred", "centred lens", instrument),
        ("moved", rendered.label, "moved element", perturbed),
    ):
        with progress.stage(stage_label, total=len(CORNERS)) as stage:
            frames = measure_chromatic(bench, camera, streams.child(name), advance=stage.advance)
        traced = bundle_prediction(bench, camera, frames.direction)
        lenses.append(LensTest(label=label, bench=bench, instrument=camera, frames=frames, traced_px=traced))
    with progress.stage("stars"):
        stars = [_shift_of_stars(config, passband, bench, camera) for camera in (instrument, perturbed)]
    example = lenses[0].frames.example
    published = is_published_sensor(config)
    image_px = float(np.hypot(*rendered.boresight_px))
    return {
        "table1": [table1_entries(lens, published=published) for lens in lenses],
        "points": [tabulate_point_shifts(lens) for lens in lenses],
        "calibration": [calibrate_bands(lens) for lens in lenses],
        "movement": RenderedMovement(
            element=rendered.element,
            kind=rendered.kind,
            amount=rendered.amount,
            unit=rendered.unit,
            wanted_px=config.decentre.wanted_px,
            image_px=image_px,
            image_arcsec=image_px * instrument.pixel_arcsec,
        ),
        "elements": solutions,
        "stars": stars,
        "centroiders": [compare_centroiders(lens, axis) for lens in lenses],
        "collimator": collimator_shift(
            bench, instrument, direction, *lenses[0].table1_px, lenses[0].frames.rms_spot_um
        ),
        "bench": BenchConditions(
            instrument=instrument,
            frame=WindowReader(instrument, streams.child("centred", "example")).frame(
                example, example.band[bench.reference]
            ),
            signal_e=signal.signal_e,
            signal_star=signal.star,
            v7_5_star_e=electrons_of_star(passband, instrument, magnitude=7.5, temperature_k=config.stars.reference_k),
            pixel_arcsec=instrument.pixel_arcsec,
            rms_spot_um=lenses[0].frames.rms_spot_um,
            reference_k=config.stars.reference_k,
            temperature_k=np.array(config.stars.temperatures_k),
        ),
    }


def _shift_of_stars(config: ChromaticConfig, passband: Band, bench: Bench, instrument: Instrument) -> StellarShifts:
    """Stars through the full pass band, and the filter shifts without a collimator at the same field positions."""
    direction, star_shift_px = stellar_shift(config.stars, passband, instrument)
    filter_px = bundle_prediction(replace(bench, collimator=None), instrument, direction[None])[0]
    return stellar_shift_statistics(star_shift_px, list(shifts(filter_px, bench.pairs).values()))


def files(result: Mapping[str, Any], folder: Path) -> None:
    """One frame as FITS: the first position behind the reference filter, full frame."""
    write_frame(result["bench"].frame, folder / "frame_upper_left.fits")


SECTIONS = {
    "table1": Section(
        record=Table1Entries,
        dim="lens",
        axes=_lens_axis,
        rows="lens pair axis",
        caption="ACC18 Table 1: mean shift between filters, halved (eq. 16).",
        note="One standard deviation, by noise of the frames and fixed pattern. RMS shift: of the "
        "points, per axis, not halved.",
        figures={"field_map": field_map},
        verdicts=[
            agree(
                "measured_px",
                "predicted_px",
                title="ACC18 Table 1, frames against ray trace, both lenses",
                advice="the centroider does not weight all light of comatic spots equally, or window_px truncates them",
            ),
            ratio_near(
                "mean_squared_pull",
                within=0.0,
                mean=True,
                square=True,
                title="Squared deviation of single shifts over the predicted variance",
                advice="noise, fixed pattern or PSF differ from the prediction's",
            ),
            agree(
                "noiseless_pixels_px",
                "predicted_px",
                false_alarm=NOISELESS_FALSE_ALARM,
                title="ACC18 Table 1, first moments of the noiseless pixels against ray trace, both lenses",
                advice="window_px truncates comatic spots, or neighbouring points overlap it (target.pitch_px)",
            ),
        ],
    ),
    "points": Section(
        record=PointShifts,
        dim="lens",
        rows="lens pair point",
        across="axis",
        caption="Shift of every target point.",
        figures={
            "fig7": curves(
                "point",
                points="measured_shift_px",
                lines="predicted_shift_px",
                by="pair",
                panels="axis",
                at={"lens": "centred"},
                y="Shift",
                aspect_ratio=0.4,
            )
        },
        verdicts=[
            agree(
                "measured_shift_px",
                "predicted_shift_px",
                title="Shift of single points, frames against ray trace",
                advice="a point on a bad pixel, or a centroider that does not weight all light equally",
            )
        ],
    ),
    "calibration": Section(
        record=CalibrationResiduals,
        dim="lens",
        rows="lens pair",
        across="step",
        caption="RMS length of the shift of a point, by the parameters that the camera model has per band.",
        note="Includes centroid noise.",
    ),
    "movement": MOVEMENT,
    "elements": ELEMENTS,
    "stars": STARS,
    "centroiders": Section(
        record=CentroiderComparison,
        dim="lens",
        rows="lens method",
        across="pair",
        caption="Results of every centroider for the same frames; ACC18 Table 1 along the axis of the movement.",
        note="Noise: standard deviation of a frame. RMS error: mean centroid minus centroid of all "
        "light (ray trace). Both per axis, over all points and filters. Empty: no convergence for "
        "some point.",
    ),
    "collimator": COLLIMATOR,
    "bench": Section(
        record=BenchConditions,
    ),
}
