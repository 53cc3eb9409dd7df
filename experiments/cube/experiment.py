"""Sun sensor to cube mirror (CUBE09): a rendered bench, trimmed face by face, reduced to R_sp, against its budget.

A collimated sun shines through an aperture onto a polished face of a cube mirror on a two-axis turntable; the table is
trimmed until the reflected spot is concentric with the aperture, first one face, then another, as the document does.
The sun sensor on the same table is calibrated by turning the table over its field. A hundred misaligned benches show
which term of the published budget (eq. 13 and 14) does what to which axis, and what would bring the error below 1
arcsec.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from experiments.cube.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.cube.result import Result

__all__ = ["Config", "experiment", "main", "run"]

VIEW_PX = (760, 440)


def run(config: Config, *, progress: Progress) -> Result:
    """Build the bench, trim, calibrate, and repeat on every misaligned bench."""

    from experiments.cube.bench import build_laboratory, draw_truths
    from experiments.cube.budget import beam_rates, build_budget, lean_rates, perfect_sensor
    from experiments.cube.montecarlo import CASES, SensorCache, run_bench, run_cases
    from experiments.cube.noise import picture_noise
    from experiments.cube.result import Result
    from experiments.cube.verify import check_light, repeatability

    with progress.stage("bench"):
        laboratory = build_laboratory(config)
        truths = draw_truths(config, laboratory.streams)
    performed = next(case for case in CASES if case.name == "procedure")
    known = SensorCache()
    with progress.stage("one bench, shown"):
        shown = run_bench(
            laboratory,
            truths[0],
            performed,
            known,
            log2_particles=config.benches.shown_log2_particles,
            keep=True,
        )
    cases = run_cases(laboratory, truths, CASES, progress)
    with progress.stage("checks"):
        light = check_light(laboratory)
        again = repeatability(laboratory)
        pictures = picture_noise(laboratory)
        budget = build_budget(laboratory, cases, pictures)
        sensor = perfect_sensor(laboratory)
        rates = lean_rates(config, sensor), beam_rates(config, sensor)
    with progress.stage("views"):
        views = _views(config, laboratory, truths[0])
    return Result(
        config=config,
        laboratory=laboratory,
        truths=truths,
        shown=shown,
        shown_run=known.runs[performed.lean],
        cases=cases,
        budget=budget,
        lean_rate=rates[0],
        beam_rate=rates[1],
        light=light,
        repeatability=again,
        picture_noise=pictures,
        views=views,
    )


def _views(config: Config, laboratory: Any, truth: Any) -> list[Any]:
    """The bench from afar and the cube from near, the first face trimmed."""
    from experiments.cube.bench import Case, build_table, concentric_angles
    from render.bench.scene import CubePose
    from render.bench.view import overview_scene, overview_sensor, render_overview

    geometry, face = laboratory.geometry, config.cube.faces[0]
    table = build_table(config, truth, Case(name="", label=""))
    angle = concentric_angles(table, truth.normal_in_table(face), face)
    top = table.rotation(angle[None])[0].as_matrix()
    pose = CubePose.of_table(geometry, top, truth.table_from_cube, truth.normal)
    scene = overview_scene(geometry, pose, top, laboratory.camera)
    width, height = VIEW_PX
    return [
        render_overview(
            scene,
            overview_sensor(geometry, width_px=width, height_px=height, close=close),
            geometry,
            spp=config.benches.view_samples,
        )
        for close in (False, True)
    ]


experiment = Experiment(
    name="cube",
    config=Config,
    run=run,
    takes="3 min (--quick: 25 s)",
    examples={
        "--quick": "six benches instead of a hundred",
        "--set camera.mounting_arcsec=0.5 --set trim.stop_px=0.3": "a stiffer mount, a stricter stop rule",
    },
    extra="quantities:trim_tables",
    show=("trims", "budget"),
    quick={
        "benches.count": 6,
        "benches.log2_particles": 17,
        "benches.shown_log2_particles": 19,
        "benches.view_samples": 8,
        "sensor.grid": 7,
    },
)
main = command(experiment)
