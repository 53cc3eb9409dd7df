"""Calibration of a star sensor with attitude-correlated frames (ACF17): Fig. 3 to 5 and Table 2."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.acf.settings import Config
from experiments.harness.cli import command
from experiments.harness.experiment import Experiment
from experiments.harness.progress import Progress

if TYPE_CHECKING:
    from experiments.acf.result import Result

__all__ = ["Config", "experiment", "main", "run"]


def run(config: Config, *, progress: Progress) -> Result:
    """Simulate, calibrate, compare."""
    from experiments.acf.checks import check_design
    from experiments.acf.expected import expected_results
    from experiments.acf.independent import check_night
    from experiments.acf.inference import infer
    from experiments.acf.monte_carlo import perform
    from experiments.acf.points import make_plan
    from experiments.acf.rendered import calibrate_rendered
    from experiments.acf.result import Result
    from experiments.acf.simulate import build_scene
    from experiments.acf.trials import sky_of

    scene = build_scene(config)
    check_design(config)
    with progress.stage("bounds"):
        inference = infer()
        inferred_um, inferred_stars = round(inference.best_um, 2), max(round(inference.best_stars), 2)
        plan = make_plan(config, inferred_um=inferred_um, inferred_stars=inferred_stars)
        expected = expected_results(config, plan, inferred_um)
    with progress.stage("Monte Carlo", total=sum(plan.runs(config, point) for point in plan.points)) as stage:
        trials = perform(config, plan, advance=stage.advance)
    stars = sky_of(config, plan.table2, 0).stars
    with progress.stage("equations written out"):
        check = check_night(config, scene, stars)
    rendered = calibrate_rendered(config, progress)
    return Result(
        config=config,
        scene=scene,
        stars=stars,
        plan=plan,
        trials=trials,
        expected=expected,
        inference=inference,
        rendered=rendered,
        check=check,
    )


experiment = Experiment(
    name="acf",
    config=Config,
    run=run,
    takes="6 min (--quick: 25 s)",
    examples={
        "--quick": "a small run, without rendered frames",
        "--set rendered.which=none --set runs=20": "star coordinates only, fewer runs",
        "--set camera.pixel_um=6.36 --set sky.stars_per_frame=21": "the pixel and the stars that Table 2 implies",
    },
    extra="rendered:results",
    show=("table2", "fig4"),
    quick={
        "rendered.which": "none",
        "runs": 12,
        "noise_px": [0.05, 0.1, 0.5],
        "bias_deg_per_h": [0.001, 0.1],
        "angle_random_walk_deg_per_sqrt_h": [0.0001, 0.01],
        "counts": [10, 20, 40],
        "sweep.stars": [3, 6, 20],
        "sweep.gyro_factor": [0.0, 1.0, 10.0],
        "sweep.skies": 12,
    },
)
main = command(experiment)
