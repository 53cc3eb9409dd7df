"""A run of the camera report: the answer first, then the page and the frames. Light to import."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from experiments.camera.answer import Swing, ThermalRange, answer_lines, limits, parameters, swings, temperatures
from experiments.camera.guides import coverage, lost_in_space
from experiments.camera.operation import RATE, in_motion, life_line, over_life
from experiments.camera.settings import Config
from experiments.harness.progress import Progress
from experiments.harness.sections import numbers_of
from experiments.harness.system import forked, prompt_import
from experiments.harness.what_if import judge
from experiments.laboratory.bench.checks import focus_remark
from experiments.laboratory.sensor_prediction import CameraPrediction, longest_trail_px, predict_camera

MADE = ("lsfe_before_arcsec", "lsfe_after_arcsec")
"""Requirements on manufactured lenses."""
SLOW = ("experiments.camera.experiment", "experiments.harness.document", "xarray", "astropy.table")
"""Modules of the report, imported when the answer is out."""


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Predict and vary, print the answer, then temperatures and frames."""
    with progress.stage("predict"):
        prediction = predict_camera(config)
    for remark in _remarks(prediction):
        progress.note(remark)
    required, motion = limits(config), None
    numbers: list[Any] = [*prediction.records, coverage(prediction)]
    warm = required.keys() & ThermalRange.__dataclass_fields__.keys()
    late = warm | (required.keys() & {RATE})

    def lines(found: list[Swing]) -> list[str]:
        return answer_lines(prediction, judge(required, numbers_of(*numbers)), found)

    first = 8 if late else 9  # what needs no further prediction
    progress.answer("\n".join(lines([])[:first]))
    found: list[Swing] = []
    with forked(partial(temperatures, config), niceness=3) as over_temperature:
        if config.tornado.parameters:
            keys = parameters(config, prediction)
            with progress.stage("what to change", total=1 + 2 * len(keys)) as stage:
                found = swings(config, prediction, advance=stage.advance)
        if warm:
            with progress.stage("temperature"):
                temperature, thermal = over_temperature()
            numbers.append(thermal)
        if RATE in required:
            with progress.stage("motion"):
                motion = in_motion(prediction, required)
            numbers += [motion] if motion is not None else []
        progress.answer("\n".join(lines(found)[first:]))
        with progress.stage("motion and life"):
            motion = in_motion(prediction, required) if motion is None else motion
            life = over_life(prediction, required)
        if life is not None:
            progress.answer(life_line(life))
        lost = None
        if not config.predict_only:
            with progress.stage("lost in space", total=config.lost.attitudes) as stage:
                lost = lost_in_space(prediction, advance=stage.advance)
        for name in SLOW:
            prompt_import(name)
        if not warm:
            with progress.stage("temperature"):
                temperature, thermal = over_temperature()
    from experiments.camera.experiment import predicted

    sections: dict[str, Any] = predicted(prediction, thermal, *(one for one in (motion, lost) if one))
    sections |= {"temperatures": temperature, "thermal": thermal, "changes": found or None}
    sections |= {"motion": motion, "life": life, "lost": lost}
    sections |= _made(prediction, required, progress)
    judged = {one.key for one in sections["requirements"]}
    judged |= set(MADE) if config.manufacture.lenses else set()
    if left_out := sorted(required.keys() - judged):
        progress.note(f"Not judged, as this run does not predict it: {', '.join(left_out)}.")
    return sections


def _remarks(prediction: CameraPrediction) -> list[str]:
    """What does not fit: focus, and spots that the centroider cuts."""
    state = prediction.state
    remark = focus_remark(state.sensor, state.light.wavelength_nm[0], state.fraction)
    room_px, setting, window_px = longest_trail_px(prediction.config, state)
    cut = f"{setting} {window_px} px cuts the spots: they need {math.ceil(window_px - room_px) // 2 * 2 + 1} px."
    return [*([remark] if remark else []), *([cut] if room_px < 0.0 else [])]


def _made(prediction: CameraPrediction, required: dict[str, tuple[float, bool]], progress: Progress) -> dict[str, Any]:
    """Manufactured lenses, and rendered frames."""
    config, sections = prediction.config, dict[str, Any]()
    if config.manufacture.lenses:
        from experiments.camera.manufacture import manufactured, yield_line

        with progress.stage("manufactured lenses", total=config.manufacture.lenses) as stage:
            sections["manufactured"] = manufactured(prediction, required, advance=stage.advance)
        progress.answer(yield_line(sections["manufactured"]))
    if config.predict_only:
        return sections
    from experiments.camera.comparison import compare, solved_frames
    from experiments.camera.frames import render_frames, rendered_lenses

    with progress.stage("frames", total=2 * config.frames.readouts + config.frames.sky) as stage:
        rendered = render_frames(prediction, advance=stage.advance)
    sections |= {"frames": compare(prediction, rendered), "solved": solved_frames(prediction, rendered)}
    if "manufactured" in sections:
        with progress.stage("frames of manufactured lenses", total=3 * config.frames.readouts) as stage:
            made = sections["manufactured"]
            sections["rendered_lenses"] = rendered_lenses(prediction, made, advance=stage.advance)
    return sections
