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
from pydantic import Field, model_validator

from experiments.cli import command
from experiments.config import ExperimentConfig, StrictModel
from experiments.progress import Progress
from experiments.settings import InstrumentConfig, StarsConfig, TargetConfig
from experiments.summary import Criterion

if TYPE_CHECKING:
    from experiments.chromatic_evaluate import Evaluation
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

    @model_validator(mode="after")
    def _reference(self) -> FilterConfig:
        if self.reference_nm not in self.centres_nm:
            raise ValueError(f"reference_nm = {self.reference_nm:g} nm is none of centres_nm = {list(self.centres_nm)}")
        if len(set(self.centres_nm)) != len(self.centres_nm):
            raise ValueError(f"centres_nm = {list(self.centres_nm)}: a centre is given twice")
        return self


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
    def _odd(self) -> Config:
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px = {self.window_px}: an odd number is needed")
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
    from experiments.chromatic_measure import Bench, measure
    from experiments.chromatic_model import band_pairs, paraxial_prediction, perturbed, solve_perturbation
    from experiments.chromatic_stars import electrons_of_star, stellar_shift
    from experiments.instrument import build_instrument
    from experiments.provenance import peak_memory_mb, process_seconds
    from experiments.target import CORNERS
    from optics.band import TopHat
    from optics.errors import unknown_name
    from optics.spectrum import Blackbody
    from render.random import Streams

    backend = str(mi.variant()).split("_")[0]
    instrument = build_instrument(config.instrument)
    centres, reference = config.filters.centres_nm, config.filters.centres_nm.index(config.filters.reference_nm)
    pairs = band_pairs(centres, reference)
    if config.decentre.pair not in [name for name, _, _ in pairs]:
        raise unknown_name("pair of bands", config.decentre.pair, [name for name, _, _ in pairs])
    lens = instrument.camera.lens
    if config.decentre.element != "auto":
        lens.indices_of(config.decentre.element)
    bench = Bench(
        target=config.target,
        lamp=Blackbody(temperature_k=config.lamp_k),
        filters=[
            TopHat(centre_nm=c, width_nm=config.filters.width_nm, edge_nm=config.filters.edge_nm, name=f"{c:g} nm")
            for c in centres
        ],
        reference=reference,
        signal_e=config.signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=tuple(dict.fromkeys((config.centroid, *config.compare))),
    )
    streams = Streams(config.seed).child("chromatic")
    with progress.stage("centred lens", total=len(CORNERS)) as stage:
        measured = measure(mi, bench, instrument, streams.child("centred"), backend=backend, advance=stage.advance)
    centred = evaluate(bench, instrument, measured, pairs)
    axis = "xy".index(config.decentre.axis)
    moves = [(element, kind) for kind in ("decentre", "tilt") for element in lens.elements]
    solutions = [
        solve_perturbation(
            mi,
            bench,
            instrument,
            measured.direction,
            element=element,
            kind=kind,
            pair=config.decentre.pair,
            axis=axis,
            wanted_px=config.decentre.wanted_px,
        )
        for element, kind in progress.track(moves, "which element")
    ]
    chosen = _choose(config, solutions)
    amount = chosen.amount / (1e3 if chosen.kind == "decentre" else 60.0)
    moved_lens = perturbed(lens, chosen.element, chosen.kind, axis, amount)
    moved_instrument = build_instrument(config.instrument, moved_lens)
    with progress.stage("moved element", total=len(CORNERS)) as stage:
        again = measure(mi, bench, moved_instrument, streams.child("moved"), backend=backend, advance=stage.advance)
    with progress.stage("stars"):
        stellar = stellar_shift(config.stars, instrument)
        star_e = electrons_of_star(config.stars, instrument, magnitude=7.5, temperature_k=config.stars.reference_k)
    return Result(
        config=config,
        instrument=instrument,
        pairs=pairs,
        centred=centred,
        moved=evaluate(bench, moved_instrument, again, pairs),
        paraxial_px=paraxial_prediction(bench, instrument, measured.direction),
        solutions=solutions,
        chosen=chosen,
        stellar=stellar,
        star_e=star_e,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def _choose(config: Config, solutions: Sequence[Solution]) -> Solution:
    """The configured element, or the one whose movement of the wanted kind is smallest."""
    from optics.errors import ConvergenceError

    able = [
        s
        for s in solutions
        if s.kind == config.decentre.kind and config.decentre.element in ("auto", s.element) and np.isfinite(s.amount)
    ]
    if not able:
        raise ConvergenceError(
            f"no {config.decentre.kind} of element {config.decentre.element!r} up to 3 mm or 3 deg gives a mean shift "
            f"of {config.decentre.wanted_px:g} px; choose another element or a smaller decentre.wanted_px"
        )
    return min(able, key=lambda s: abs(s.amount))


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
