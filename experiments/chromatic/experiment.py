"""The chromatic test: run and declaration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.chromatic.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress
from experiments.laboratory.own_frames.experiment import or_own_frames
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.chromatic.perturbation import Solution
    from experiments.chromatic.result import Result
    from experiments.laboratory.bench import Bench
    from experiments.laboratory.instrument import Instrument
    from optics.lens.system import LensSystem

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Render, read out, reduce and compare."""

    from experiments.chromatic.result import Result
    from experiments.chromatic.stars import stellar_shift
    from experiments.laboratory.chromatic_error import measure_chromatic, reduce_chromatic, shifts
    from experiments.laboratory.collimator_effects import chromatic_effect
    from experiments.laboratory.filter_wheel import open_band
    from experiments.laboratory.instrument import build_instrument
    from experiments.laboratory.known_motion import measure_wedged
    from experiments.laboratory.ray_prediction import bundle_prediction, paraxial_prediction
    from experiments.laboratory.signal import electrons_of_star, signal_of
    from experiments.laboratory.target import CORNERS
    from render.engine.random import Streams

    instrument = build_instrument(config.instrument)
    band = open_band(config.passband, instrument, "full pass band")
    signal = signal_of(config, band, instrument, config.stars.reference_k)
    bench, direction = _prepare(config, instrument, signal.signal_e)
    paraxial_px = paraxial_prediction(bench, instrument, direction)
    solutions = _solve(config, bench, instrument, direction, progress)
    chosen = _choose(config, bench, instrument.camera.lens, solutions)
    moved = _moved(config, instrument, chosen)
    streams = Streams(config.seed).child("chromatic")
    found = {}
    for label, stage_label, one in (("centred", "centred lens", instrument), ("moved", "moved element", moved)):
        with progress.stage(stage_label, total=len(CORNERS)) as stage:
            measured = measure_chromatic(bench, one, streams.child(label), advance=stage.advance)
        found[label] = reduce_chromatic(bench, one, measured)
    with progress.stage("wedge in a filter"):
        wedged = measure_wedged(bench, instrument, found["centred"].measurement, streams.child("wedge"))
    with progress.stage("stars"):
        stellar, moved_stellar = (stellar_shift(config.stars, band, one) for one in (instrument, moved))
        ideal = replace(bench, collimator=None)  # stars have none
        field_shift = shifts(bundle_prediction(ideal, instrument, stellar.direction[None]), bench.pairs)
        star_e = electrons_of_star(band, instrument, magnitude=7.5, temperature_k=config.stars.reference_k)
    return Result(
        config=config,
        bench=bench,
        instrument=instrument,
        centred=found["centred"],
        moved=found["moved"],
        wedged=wedged,
        paraxial_px=paraxial_px,
        solutions=solutions,
        chosen=chosen,
        stellar=stellar,
        moved_stellar=moved_stellar,
        field_shift_px={name: shift[0] for name, shift in field_shift.items()},
        star_e=star_e,
        collimator=chromatic_effect(
            bench,
            instrument,
            direction,
            found["centred"].table1_px,
            found["centred"].table1_sigma_px,
            found["centred"].measurement.rms_spot_um,
        ),
        signal=signal,
    )


def _prepare(config: Config, instrument: Instrument, signal_e: float) -> tuple[Bench, FloatArray]:
    """Laboratory and target points; whatever can be refused without rendering is refused here."""
    from experiments.laboratory.bench import Bench
    from experiments.laboratory.checks import check_light
    from experiments.laboratory.collimator import build_collimator
    from experiments.laboratory.filter_wheel import interference_filters
    from experiments.laboratory.target import corner_directions
    from optics.errors import unknown_name
    from optics.light.spectrum import Blackbody

    wheel = config.filters
    filters = interference_filters(wheel)
    bench = Bench(
        target=config.target,
        lamp=Blackbody(temperature_k=config.lamp_k),
        filters=filters,
        reference=wheel.centres_nm.index(wheel.reference_nm),
        signal_e=signal_e,
        frames=config.frames,
        dark_frames=config.dark_frames,
        window_px=config.window_px,
        methods=config.methods,
        collimator=build_collimator(config.collimator, filters),
    )
    for band in bench.filters:
        instrument.check_band("filters.centres_nm", band)
    names = [name for name, _, _ in bench.pairs]
    if config.pair not in names:
        raise unknown_name("decentre.pair", config.pair, names)
    if config.decentre.element != "auto":
        instrument.camera.lens.indices_of(config.decentre.element)
    direction = corner_directions(config.target, instrument)
    check_light(bench, instrument, direction)
    return bench, direction


def _solve(
    config: Config, bench: Bench, instrument: Instrument, direction: FloatArray, progress: Progress
) -> list[Solution]:
    """The movement of every element, decentre and tilt, that gives the published number."""
    from experiments.chromatic.perturbation import solve_perturbation

    moves = [(element, kind) for kind in ("decentre", "tilt") for element in instrument.camera.lens.elements]
    return [
        solve_perturbation(
            bench,
            instrument,
            direction,
            element=element,
            kind=kind,
            pair=config.pair,
            axis="xy".index(config.decentre.axis),
            wanted_px=config.decentre.wanted_px,
        )
        for element, kind in progress.track(moves, "which element")
    ]


def _moved(config: Config, instrument: Instrument, chosen: Solution) -> Instrument:
    """The camera with the chosen element moved."""
    from experiments.laboratory.instrument import build_instrument

    return build_instrument(config.instrument, chosen.apply(instrument.camera.lens, "xy".index(config.decentre.axis)))


def _choose(config: Config, bench: Bench, lens: LensSystem, solutions: Sequence[Solution]) -> Solution:
    """The configured element, or the one whose movement of the wanted kind is smallest."""
    from experiments.chromatic.perturbation import check_motion
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
        if not lens.glasses:
            raise ConvergenceError(
                f"lens {lens.name!r} has no glass, and mirrors no colour: no movement gives a mean shift of "
                f"decentre.wanted_px = {wanted.wanted_px:g} px; set decentre.wanted_px = 0"
            )
        raise ConvergenceError(
            f"no {wanted.kind} of {who} up to {reach} gives a mean shift of decentre.wanted_px = "
            f"{wanted.wanted_px:g} px in {config.pair}, {wanted.axis}; lower it, or choose another "
            "decentre.element or decentre.kind"
        )
    chosen = min(able, key=lambda s: abs(s.amount))
    check_motion(bench, chosen, wanted.wanted_px)
    return chosen


def files(result: Result, folder: Any) -> None:
    """One frame as FITS: the first position behind the reference filter, the whole detector."""
    from render.detector.readout import expose
    from render.engine.random import Streams
    from render.fits.files import write_frame

    example = result.centred.measurement.example
    frame = expose(
        example,
        result.instrument.detector,
        streams=Streams(result.config.seed).child("chromatic", "centred", "example"),
        temperature_c=result.config.instrument.chip_temperature_c,
        band=example.band[result.config.filters.centres_nm.index(result.config.filters.reference_nm)],
    )
    write_frame(frame, folder / "frame_upper_left.fits")


rendered = Experiment(
    name="chromatic",
    config=Config,
    run=run,
    takes="45 s (--quick: 20 s)",
    examples={
        "--quick": "a small run",
        "--set decentre.element=L3 --set decentre.kind=tilt": "another element of the lens moved",
        "--set centroid=cog --set instrument.defocus_mm=0.03": "another centroider, out of focus",
    },
    show=("table1",),
    files=files,
    quick={"frames": 6, "dark_frames": 20, "stars.grid": 3, "target.rows": 3, "target.columns": 3, "compare": ["cog"]},
)
experiment = or_own_frames(rendered, "experiments.chromatic.own_frames")
main = command(experiment)
