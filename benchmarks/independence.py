"""Functions of this repository that both sides of a comparison, prediction and measurement, run.

Run from the repository root: ``python benchmarks/independence.py`` (some ten minutes); it writes docs/independence.md.
``--only NAME`` runs one experiment and prints its result.

Every experiment runs as ``--quick`` in this process, under a profiler (`sys.setprofile`) that notes which Python
functions are called. A comparison names the functions with which its two sides begin; functions called from there
belong to that side, functions called from both are shared. Caches are emptied when a side begins, so that none uses
results of the other; processes of a Monte Carlo are run in this one. Not counted: the harness, records, checks of
input, units, array backends, and the common preparation of both sides (instrument, target, source). Kernels of Dr.Jit
count through the Python functions that write them. `WORDS` states for every shared room which errors sharing can hide;
a room without such a text ends the run.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import sys
import tempfile
import threading
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

PAGE = ROOT / "docs" / "independence.md"
ROOMS = ("optics", "render", "calib", "experiments")
LEFT_OUT = (
    *(
        "experiments/harness",
        "optics/records",
        "render/records",
        "calib/records",
        "calib/flags",
        "calib/measure/centroiding/options",
    ),
    *("optics/errors", "optics/validate", "optics/units", "optics/arrays"),
    *("render/plugins", "render/engine/engine", "render/engine/arrays", "render/engine/jit"),
)
PREDICTED, MEASURED = 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """A prediction and its measurement.

    Attributes
    ----------
    experiment : str
        Which runs both.
    what : str
        Number that is compared.
    predicted, measured : tuple of str
        Functions with which the sides begin, ``module:qualified name``; a side ends where one of the other's begins.
    both : tuple of str
        Functions whose results both sides take, from any caller.
    settings : tuple of str
        Of the run.
    """

    experiment: str
    what: str
    predicted: tuple[str, ...]
    measured: tuple[str, ...]
    both: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    def sides(self) -> dict[str, int]:
        """Function -> the side that it begins."""
        named = ((self.predicted, PREDICTED), (self.measured, MEASURED), (self.both, PREDICTED | MEASURED))
        return {name: side for names, side in named for name in names}


NO, YES = "no", "yes"
WORDS: dict[str, tuple[str, str]] = {
    "optics/glass": (YES, "indices against the makers' printed values, opticalglass, SCHOTT's dn/dT; air against NIST"),
    "optics/lens": (
        YES,
        "rays through three lenses against batoid, intersections against the sag; a lens against its patent",
    ),
    "optics/rays": (YES, "rays, path and pupils against batoid and optiland; foci against ABCD matrices"),
    "optics/light": (YES, "band integrals and black bodies against closed forms (Stefan-Boltzmann, zero points)"),
    "optics/response": (YES, "linear between nodes; curves are data with a source"),
    "optics/frames": (YES, "a star towards +X lands at a larger column; conversions against FITS, tetra3, Mitsuba"),
    "render/camera": (YES, "pixels of chief rays against a trace in other coordinates (chromatic, tests)"),
    "render/sensor": (YES, "angle of a pixel against focal length and pitch"),
    "render/forward": (NO, "it only passes arguments"),
    "render/tracing": (
        "yes, where the prediction uses the renderer's PSF: hsfe does not notice excess charge diffusion",
        "pixels within 1e-5 of a NumPy trace with integrals by the error function; moments in closed form",
    ),
    "render/detector": (
        "no: only the data sheet and a pixel's mean and variance; the read-out chain runs on the measured side alone",
        "photon transfer of frames; each effect of the chain against its law",
    ),
    "render/engine": (NO, "random streams, with different names on the two sides"),
    "render/sky": (YES, "star light against the integral of its spectrum; magnitudes against published zero points"),
    "render/bench": (NO, "dimensions of the bench, and the position of the mask's spot, against traced particles"),
    "calib/measure": (
        "yes: both sides contain the centroider's bias; only hsfe compares cog with the centroid of the light",
        "every centroider against truth, bound and scatter on stars by other codes; photutils, sep; injected shifts",
    ),
    "calib/cameras": (
        YES,
        "OpenCV for projections, finite differences for derivatives, drawn parameters for line-of-sight maps",
    ),
    "calib/attitude": (YES, "matrices as printed in ACC18, ACF17, CUBE09; SciPy; scatter of 4000 frames"),
    "calib/calibration": (
        "no: the budget uses it only to predict the error by axes that are not square, from exact positions",
        "truth of simulated benches; scipy.optimize.least_squares; scatter over the bound",
    ),
    "calib/fitting": (NO, "NIST's certified fits; scipy.optimize.least_squares"),
    "calib/directional": (NO, "only the choice of a basis of the tangent plane, which is arbitrary"),
    "experiments/laboratory": (
        "yes: the statistics of ACC18 (RMS of steps, polynomial, mean shift) and the position of the target",
        "closed forms, written-out sums; injected shifts and polynomials; criteria computed independently",
    ),
    "experiments/budget": (
        "yes: the sum of the terms; with a single survey also the marking error",
        "the printed terms of ACC18 give its printed sums",
    ),
    "experiments/acf": (
        "yes: stars, motion, and the derivatives of the linear model, which also give the bound of each run",
        "derivatives against finite differences, bound against calib.calibration, scatter against both",
    ),
    "experiments/camera": (
        "no: only the sky, and a star's light per square millimetre, which other tests check",
        "catalogue against astropy; electrons by hand; pupil area against the renderer's own quadrature",
    ),
    "experiments/fisher": (
        "no: only the noise passed to the centroiders, and the sum of predicted variances",
        "both pixel methods over the field against closed forms; the concentration against 60-digit arithmetic",
    ),
    "optics/lens_file": ("no: it only reads the lens of both sides", "round trips of lens files"),
    "optics/files": ("no: it only reads the lens of both sides", "focal lengths and traces against other codes"),
    "optics/textfile": ("no: it only reads the lens of both sides", "encodings in the tests of lens files"),
    "experiments/cube": (
        "yes: geometry of faces and readings, and the reduction of perfect positions",
        "CUBE09 eq. 7 written out; a traced reflection; finite differences",
    ),
    "experiments/skycal": (
        YES,
        "the truth comes from the renderer's own tracer: see `render/tracing`",
    ),
}
"""Shared room -> whether an error in it can go unseen because both sides make it, and what would see it."""

LABORATORY, PSFS = "experiments.laboratory", ("experiments.laboratory.bench.points:PointScene.filter_psfs",)
COMPARISONS = (
    Comparison(
        experiment="temporal",
        what="temporal error",
        predicted=(f"{LABORATORY}.temporal_error:predict_temporal",),
        measured=(f"{LABORATORY}.temporal_error:measure_temporal",),
        both=PSFS,
    ),
    Comparison(
        experiment="hsfe",
        what="high spatial frequency error",
        predicted=(f"{LABORATORY}.high_frequency_model:predict_high_frequency",),
        measured=(f"{LABORATORY}.high_frequency:measure_high_frequency",),
        both=PSFS,
    ),
    Comparison(
        experiment="distortion",
        what="distortion before the fit, after the fit, and the part removed",
        predicted=(f"{LABORATORY}.distortion_model:predict_distortion",),
        measured=(
            f"{LABORATORY}.distortion_error:measure_distortion",
            f"{LABORATORY}.distortion_error:DistortionMeasurement.over_surveys",
        ),
        both=PSFS,
    ),
    Comparison(
        experiment="chromatic",
        what="shift between filters",
        predicted=(f"{LABORATORY}.bench.ray_prediction:bundle_prediction",),
        measured=(f"{LABORATORY}.chromatic_error:measure_chromatic",),
    ),
    Comparison(
        experiment="budget",
        what="all terms",
        predicted=("experiments.budget.predict:predict_terms", f"{LABORATORY}.bench.ray_prediction:bundle_prediction"),
        measured=("experiments.budget.measure:measure_terms",),
        both=PSFS,
    ),
    Comparison(
        experiment="camera",
        what="noise, detection, attitude",
        predicted=("experiments.laboratory.sensor_prediction:predict_camera",),
        measured=("experiments.camera.frames:render_frames",),
    ),
    Comparison(
        experiment="acf",
        what="reprojection error and covariance",
        predicted=("experiments.acf.reprojection:expected_at", "experiments.acf.table2:covariances"),
        measured=("experiments.acf.trials:run_trials",),
    ),
    Comparison(
        experiment="skycal",
        what="map of the line of sight against the traced lens",
        predicted=("experiments.skycal.positions:trace_chart",),
        measured=(
            "experiments.skycal.measure:record",
            "experiments.skycal.match:match_frames",
            "experiments.skycal.calibrate:Calibrator.calibrate",
        ),
    ),
    Comparison(
        experiment="turntable",
        what="error of the line-of-sight map against its bound",
        predicted=("calib.calibration.table_bound:table_bound",),
        measured=(
            "experiments.turntable.monte_carlo:monte_carlo",
            "experiments.turntable.experiment:calibrate_rendered",
        ),
    ),
    Comparison(
        experiment="fisher",
        what="scatter of star vectors",
        predicted=(
            "calib.directional.vector_scatter:scatter_of_other_data",
            "calib.directional.vector_scatter:scatter_of_own_data",
            "calib.calibration.star_bench:star_vector_by_pixel",
            "calib.calibration.star_bench:clock_covariance_px2",
            "calib.calibration.star_bench:design_star_last",
            "experiments.fisher.accuracy:_expected",
        ),
        measured=("experiments.fisher.accuracy:run_rendered",),
    ),
    Comparison(
        experiment="cube",
        what="error of R_sp, term by term",
        predicted=("experiments.cube.budget:build_budget",),
        measured=("experiments.cube.montecarlo:run_cases",),
    ),
    Comparison(
        experiment="dataset",
        what="centroid error against its bound",
        predicted=("experiments.dataset.detection:dataset_bound",),
        measured=(
            "experiments.dataset.workers:make_frames",
            "experiments.dataset.experiment:evaluate",
        ),
        settings=("workers=1",),
    ),
)


@dataclass(slots=True)
class Recorder:
    """Profile function that records the functions of each side.

    Attributes
    ----------
    side : dict of str to int
        Function -> the side that it begins.
    seen : dict of str to int
        Function -> the sides on which it ran.
    begun : set of str
        Those of ``side`` that were called.
    """

    side: Mapping[str, int]
    seen: defaultdict[str, int] = field(default_factory=lambda: defaultdict(int))
    begun: set[str] = field(default_factory=set)
    _name: dict[CodeType, str] = field(default_factory=dict)
    _stack: threading.local = field(default_factory=threading.local)
    _main: list[int] = field(default_factory=list)

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Note a call or a return."""
        try:
            stack = self._stack.sides
        except AttributeError:  # a new thread works for the side that started it
            stack = self._stack.sides = [self._main[-1]] if self._main else [0]
            if threading.current_thread() is threading.main_thread():
                self._main = stack
        if event == "call":
            name = self._name.get(frame.f_code)
            if name is None:
                name = self._name[frame.f_code] = name_of(frame)
            side = stack[-1]
            if name in self.side:
                self.begun.add(name)
                if not side:
                    empty_caches()
                side = self.side[name]
            stack.append(side)
            if side and name:
                self.seen[name] |= side
        elif event == "return" and len(stack) > 1:
            stack.pop()

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Profile this and all new threads."""
        threading.setprofile(self)
        sys.setprofile(self)
        try:
            yield
        finally:
            sys.setprofile(None)
            threading.setprofile(None)


class Here(concurrent.futures.Executor):
    """Executor that works at once in this process, under the profiler."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def submit(self, function: Any, /, *arguments: Any, **named: Any) -> Any:
        """The result, as of a process."""
        done: concurrent.futures.Future[Any] = concurrent.futures.Future()
        done.set_result(function(*arguments, **named))
        return done


def name_of(frame: FrameType) -> str:
    """``module:function`` of a counted function of this repository, inner functions under the outer one; else ""."""
    path = Path(frame.f_code.co_filename)
    if not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in ROOMS:
        return ""
    inside = path.relative_to(ROOT).with_suffix("").as_posix()
    name = frame.f_code.co_qualname.partition(".<locals>")[0]
    if inside.startswith(LEFT_OUT) or "<" in name or name.endswith("__post_init__"):
        return ""
    return f"{inside.replace('/', '.').removesuffix('.__init__')}:{name}"


def empty_caches() -> None:
    """Forget what functions of this repository remember."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ROOMS and not name.startswith(("render.engine", "experiments.harness")):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


def record(comparison: Comparison) -> Recorder:
    """Run an experiment and note who runs what."""
    from experiments.harness.config import load_config
    from experiments.harness.progress import Progress
    from experiments.harness.registry import declared
    from experiments.harness.run import finished
    from render.engine import Engine

    concurrent.futures.ProcessPoolExecutor = Here  # type: ignore[misc]
    experiment = declared(comparison.experiment)
    config = load_config(experiment.config, quick=experiment.quick, settings=list(comparison.settings))
    Engine.start("auto")
    recorder = Recorder(comparison.sides())
    with tempfile.TemporaryDirectory() as folder:
        output = {"output": experiment.part(experiment.output)(f"{folder}/out", config)} if experiment.output else {}
        with recorder.recording():
            result = experiment.part(experiment.run)(config, progress=Progress(), **output)
            finished(experiment, config, result, quick=True)
    missing = set(comparison.sides()) - recorder.begun
    if missing:
        sys.exit(f"{comparison.experiment}: {', '.join(sorted(missing))} did not run; name where its sides begin")
    return recorder


def room_of(function: str) -> str:
    """Room of a function: ``optics/rays``."""
    return "/".join(function.partition(":")[0].split(".")[:2])


Found = Mapping[str, tuple[set[str], set[str]]]
"""Experiment -> functions of the predicted and of the measured side."""


def overview(found: Found) -> list[str]:
    """A line for each comparison: number of functions that each side runs, and of shared functions by room."""
    lines = [
        "| experiment | quantity compared | functions: prediction | measurement | shared | shared, by room |",
        "|---|---|---|---|---|---|",
    ]
    what = {one.experiment: one.what for one in COMPARISONS}
    for name, (predicted, measured) in found.items():
        rooms = Counter(map(room_of, predicted & measured))
        of_these = ", ".join(f"`{room}` {count}" for room, count in sorted(rooms.items()))
        counts = f"{len(predicted)} | {len(measured)} | {len(predicted & measured)}"
        lines.append(f"| {name} | {what[name]} | {counts} | {of_these} |")
    return lines


def in_words(rooms: Sequence[str]) -> list[str]:
    """A line for each shared room: what sharing can hide, and what covers it."""
    unsaid = [room for room in rooms if room not in WORDS]
    if unsaid:
        sys.exit(f"shared rooms without a text in WORDS: {', '.join(unsaid)}")
    lines = ["| shared room | can an error hide? | independent test, or what is shared |", "|---|---|---|"]
    return lines + [f"| `{room}` | {WORDS[room][0]} | {WORDS[room][1]} |" for room in rooms]


def page(found: Found) -> str:
    """The page of the documents."""
    rooms = sorted({room_of(name) for predicted, measured in found.values() for name in predicted & measured})
    parts = [
        ["# What predictions and measurements share"],
        [
            "The table counts the functions that ran in the prediction, in the measurement and in both, traced in",
            "quick runs by `python benchmarks/independence.py` (`--only NAME` lists an experiment's functions).",
            "Records, input checks, units, harness and array backends are not counted. Agreement of prediction and",
            "measurement does not test an equation that both use. Such equations are tested separately;",
            "[random mutants](validation/evidence.md) measure how many errors these tests notice.",
        ],
        overview(found),
        ["## What sharing can hide"],
        in_words(rooms),
    ]
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def main() -> None:
    """Trace, intersect, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="NAME", help="one experiment; its shared functions are printed")
    only = parser.parse_args().only
    found = {}
    for one in COMPARISONS:
        if only in (None, one.experiment):
            seen = record(one).seen
            sides = [{name for name, side in seen.items() if side & wanted} for wanted in (PREDICTED, MEASURED)]
            found[one.experiment] = (sides[0], sides[1])
            print(f"{one.experiment}: {len(sides[0] & sides[1])} of {len(sides[0])} and {len(sides[1])}", flush=True)
    if only:
        print("\n".join(sorted(set.intersection(*found[only]))))
    else:
        PAGE.write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
