"""Chromatic LSFE of a star camera (ACC18, section 1.4.1): filters, a point target in four corners, thirty frames each.

A 5 x 5 point target is rendered through the lens prescription behind three filters at four edge positions, read out
with noise, detected, centroided and reduced as the document does (eq. 13-16, Table 1, Fig. 7); every shift stands
beside the simulation's truth and a ray-trace prediction. Then what the document leaves open: why its signed mean
vanishes for a centred lens, which movement of which element gives its 0.12 px, and whether "one third" holds for stars.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from experiments.cli import command
from experiments.config import ExperimentConfig, StrictModel
from experiments.progress import Progress
from experiments.settings import InstrumentConfig, StarsConfig, TargetConfig
from experiments.summary import Criterion

if TYPE_CHECKING:
    from experiments.chromatic_evaluate import Evaluation
    from experiments.chromatic_measure import Bench
    from experiments.chromatic_model import Solution
    from experiments.chromatic_stars import StellarShift
    from experiments.instrument import Instrument
    from experiments.report import Report
    from experiments.tables import Table

__all__ = ["Config", "Result", "main", "report", "run", "summary", "tables"]

FloatArray = NDArray[np.float64]
Method = Literal["epsf", "gaussian", "windowed", "tcog", "cog"]


class FilterConfig(StrictModel):
    """Interference filters; ``reference_nm`` is the one that the others are compared with."""

    centres_nm: tuple[float, ...] = Field(default=(500.0, 600.0, 800.0), min_length=2, description="band centres")
    reference_nm: float = Field(default=600.0, description="centre of the reference band; one of centres_nm")
    width_nm: float = Field(default=100.0, gt=0, le=400, description="full width at half maximum")
    edge_nm: float = Field(default=10.0, ge=0, le=100, description="length of each edge, 0 to 100 %")

    @field_validator("centres_nm")
    @classmethod
    def _different(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if len({f"{value:g}" for value in values}) != len(values):
            raise ValueError("a centre is given twice")
        return values

    @field_validator("reference_nm")
    @classmethod
    def _one_of_them(cls, value: float, info: ValidationInfo) -> float:
        centres = info.data.get("centres_nm")  # absent if it is wrong itself, which is said then
        if centres is not None and value not in centres:
            raise ValueError(f"it is none of centres_nm = {list(centres)}")
        return value


class DecentreConfig(StrictModel):
    """Which published number is to be reproduced by moving an element."""

    wanted_px: float = Field(default=0.12, description="mean shift, halved (ACC18 Table 1)")
    pair: str = Field(default="800-600", description="pair of bands")
    axis: Literal["x", "y"] = Field(default="x", description="axis of Table 1")
    element: str = Field(default="auto", description="element to move in the rendered check; auto: see kind")
    kind: Literal["decentre", "tilt"] = Field(default="decentre", description="how it moves in the rendered check")


class Config(ExperimentConfig):
    """The published run: ACC18 gives all of it but the signal, the pass band of the stars and the lens."""

    instrument: InstrumentConfig = InstrumentConfig()
    target: TargetConfig = TargetConfig()
    filters: FilterConfig = FilterConfig()
    lamp_k: float = Field(default=3000.0, ge=1000, le=20000, description="colour temperature of the lamp")
    signal_e: float = Field(default=6000.0, gt=0, le=1e6, description="electrons per point and frame, every filter")
    frames: int = Field(default=30, ge=2, le=10000, description="frames per position and filter")
    dark_frames: int = Field(default=100, ge=2, le=10000, description="frames with the lamp off, per position")
    window_px: int = Field(default=13, ge=7, le=63, description="window around a point, odd")
    centroid: Method = Field(default="epsf", description="centroider that counts")
    compare: tuple[Method, ...] = Field(
        default=("gaussian", "windowed", "tcog", "cog"), description="others shown beside it"
    )
    decentre: DecentreConfig = DecentreConfig()
    stars: StarsConfig = StarsConfig()

    @model_validator(mode="after")
    def _windows(self) -> Config:
        size, target = self.window_px, self.target
        if size % 2 == 0:
            raise ValueError(f"window_px = {size}: an odd number is needed")
        if target.rows * target.columns > 1 and target.pitch_px < size:
            raise ValueError(
                f"target.pitch_px = {target.pitch_px:g} px: at least window_px = {size} px is needed, or "
                "one window holds two points"
            )
        if target.edge_px < size // 2 + 1:
            raise ValueError(
                f"target.edge_px = {target.edge_px:g} px: at least {size // 2 + 1} px is needed, or windows of "
                f"window_px = {size} px leave the detector"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Everything the run found.

    Attributes
    ----------
    config : Config
        Settings.
    instrument : Instrument
        The centred camera.
    pairs : sequence of (str, int, int)
        Pairs of bands.
    centred, moved : Evaluation
        The lens as designed; with the element of ``chosen`` moved.
    paraxial_px : (p, j, b, 2)
        Paraxial lateral colour of the centred lens.
    solutions : sequence of Solution
        The movement of each element, decentre and tilt, that gives the published number.
    chosen : Solution
        The one that was rendered.
    stellar : StellarShift
        Stars through the full pass band.
    field_shift_px : dict of str to (g, 2)
        Shifts between the filters at the stars' places, by ray trace.
    star_e : float
        Electrons of a V = 7.5 star of the reference temperature through the full pass band.
    runtime_s, peak_memory_mb : float
        Of the process up to the end of the run.
    """

    config: Config
    instrument: Instrument
    pairs: Sequence[tuple[str, int, int]]
    centred: Evaluation
    moved: Evaluation
    paraxial_px: FloatArray
    solutions: Sequence[Solution]
    chosen: Solution
    stellar: StellarShift
    field_shift_px: Mapping[str, FloatArray]
    star_e: float
    runtime_s: float
    peak_memory_mb: float


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, reduce and compare.

    Parameters
    ----------
    config : Config
        Settings.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        On anything the user can mend: unknown lens or detector, target off the detector, points not detected or
        saturated, a wavelength outside the range of a glass or of the quantum efficiency.
    """
    import mitsuba as mi

    from experiments.chromatic_evaluate import evaluate
    from experiments.chromatic_measure import measure
    from experiments.chromatic_model import bundle_prediction, paraxial_prediction, perturbed, shifts
    from experiments.chromatic_stars import electrons_of_star, stellar_shift
    from experiments.instrument import build_instrument
    from experiments.provenance import peak_memory_mb, process_seconds
    from experiments.target import CORNERS, corner_directions
    from render.random import Streams

    backend = str(mi.variant()).split("_")[0]
    instrument = build_instrument(config.instrument)
    bench, pairs = _prepare(config, instrument)
    direction = corner_directions(config.target, instrument)
    paraxial_px = paraxial_prediction(bench, instrument, direction)
    solutions = _solve(mi, config, bench, instrument, direction, progress)
    chosen = _choose(config, bench, solutions)
    amount = chosen.amount / (1e3 if chosen.kind == "decentre" else 60.0)
    axis = "xy".index(config.decentre.axis)
    moved = build_instrument(
        config.instrument, perturbed(instrument.camera.lens, chosen.element, chosen.kind, axis, amount)
    )
    streams = Streams(config.seed).child("chromatic")
    found = {}
    for label, stage_label, one in (("centred", "centred lens", instrument), ("moved", "moved element", moved)):
        with progress.stage(stage_label, total=len(CORNERS)) as stage:
            measured = measure(mi, bench, one, streams.child(label), backend=backend, advance=stage.advance)
        found[label] = evaluate(bench, one, measured, pairs)
    with progress.stage("stars"):
        stellar = stellar_shift(config.stars, instrument)
        field_shift = shifts(bundle_prediction(bench, instrument, stellar.direction[None]), pairs)
        star_e = electrons_of_star(config.stars, instrument, magnitude=7.5, temperature_k=config.stars.reference_k)
    return Result(
        config=config,
        instrument=instrument,
        pairs=pairs,
        centred=found["centred"],
        moved=found["moved"],
        paraxial_px=paraxial_px,
        solutions=solutions,
        chosen=chosen,
        stellar=stellar,
        field_shift_px={name: shift[0] for name, shift in field_shift.items()},
        star_e=star_e,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def _prepare(config: Config, instrument: Instrument) -> tuple[Bench, Sequence[tuple[str, int, int]]]:
    """The laboratory and the pairs of bands; whatever can be refused without rendering is refused here."""
    from experiments.chromatic_checks import check_light, check_wavelengths
    from experiments.chromatic_measure import Bench
    from experiments.chromatic_model import band_pairs
    from experiments.chromatic_stars import passband
    from experiments.target import corner_directions
    from optics.band import TopHat
    from optics.errors import unknown_name
    from optics.spectrum import Blackbody

    filters = config.filters
    reference = filters.centres_nm.index(filters.reference_nm)
    pairs = band_pairs(filters.centres_nm, reference)
    bench = Bench(
        target=config.target,
        lamp=Blackbody(temperature_k=config.lamp_k),
        filters=[
            TopHat(centre_nm=c, width_nm=filters.width_nm, edge_nm=filters.edge_nm, name=f"{c:g} nm")
            for c in filters.centres_nm
        ],
        reference=reference,
        signal_e=config.signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=tuple(dict.fromkeys((config.centroid, *config.compare))),
    )
    bands = [("filters.centres_nm", band) for band in bench.filters]
    check_wavelengths(instrument, [*bands, ("stars.passband_nm", passband(config.stars))])
    if config.decentre.pair not in [name for name, _, _ in pairs]:
        raise unknown_name("decentre.pair", config.decentre.pair, [name for name, _, _ in pairs])
    if config.decentre.element != "auto":
        instrument.camera.lens.indices_of(config.decentre.element)
    check_light(bench, instrument, corner_directions(config.target, instrument))
    return bench, pairs


def _solve(
    mi: Any, config: Config, bench: Bench, instrument: Instrument, direction: FloatArray, progress: Progress
) -> list[Solution]:
    """The movement of every element, decentre and tilt, that gives the published number."""
    from experiments.chromatic_model import solve_perturbation

    moves = [(element, kind) for kind in ("decentre", "tilt") for element in instrument.camera.lens.elements]
    return [
        solve_perturbation(
            mi,
            bench,
            instrument,
            direction,
            element=element,
            kind=kind,
            pair=config.decentre.pair,
            axis="xy".index(config.decentre.axis),
            wanted_px=config.decentre.wanted_px,
        )
        for element, kind in progress.track(moves, "which element")
    ]


def _choose(config: Config, bench: Bench, solutions: Sequence[Solution]) -> Solution:
    """The configured element, or the one whose movement of the wanted kind is smallest."""
    from experiments.chromatic_checks import check_motion
    from optics.errors import ConvergenceError

    wanted = config.decentre
    able = [
        s
        for s in solutions
        if s.kind == wanted.kind and wanted.element in ("auto", s.element) and np.isfinite(s.amount)
    ]
    if not able:
        who = "any element" if wanted.element == "auto" else f"element {wanted.element}"
        reach = "3 mm" if wanted.kind == "decentre" else "3 deg"
        raise ConvergenceError(
            f"no {wanted.kind} of {who} up to {reach} gives a mean shift of decentre.wanted_px = "
            f"{wanted.wanted_px:g} px in {wanted.pair}, {wanted.axis}; lower it, or choose another "
            "decentre.element or decentre.kind"
        )
    chosen = min(able, key=lambda s: abs(s.amount))
    check_motion(bench, chosen, wanted.wanted_px)
    return chosen


def summary(result: Result) -> tuple[dict[str, Any], list[Criterion]]:
    """What goes into ``summary.json``."""
    from experiments.chromatic_evaluate import criteria, results

    return results(result), criteria(result)


def tables(result: Result) -> Mapping[str, Table]:
    """Tables written beside the report."""
    from experiments.chromatic_tables import all_tables

    return all_tables(result)


def report(result: Result) -> Report:
    """What ``report.html`` shows."""
    from experiments.chromatic_report import build_report

    return build_report(result)


def files(result: Result, folder: Any) -> None:
    """One frame as FITS: the first position behind the reference filter, the whole detector."""
    import mitsuba as mi

    from render.fits import write_frame
    from render.random import Streams
    from render.readout import expose

    example = result.centred.measurement.example
    frame = expose(
        example,
        result.instrument.detector,
        streams=Streams(result.config.seed).child("chromatic", "centred", "example"),
        temperature_c=result.config.instrument.chip_temperature_c,
        band=example.band[result.config.filters.centres_nm.index(result.config.filters.reference_nm)],
        backend=str(mi.variant()).split("_")[0],
    )
    write_frame(frame, folder / "frame_upper_left.fits")


main = command(
    "chromatic",
    config=Config,
    run=run,
    report=report,
    summary=summary,
    tables=tables,
    show=("table1",),
    files=files,
    quick={"frames": 6, "dark_frames": 20, "stars.grid": 3, "target.rows": 3, "target.columns": 3, "compare": ["cog"]},
)

if __name__ == "__main__":
    sys.exit(main())
