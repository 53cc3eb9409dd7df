"""A run of the camera report: the answer first, then the page and the frames. Light to import.

The lines of the answer are printed as soon as their predictions exist; the predictions over temperature run in a
process of their own and are awaited only when a requirement, or the page, needs them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from experiments.camera.answer import (
    ADVICE,
    VERDICT,
    Swing,
    Temperatures,
    ThermalRange,
    answer_rows,
    limits,
    parameters,
    swings,
    temperatures,
)
from experiments.camera.guides import coverage, lost_in_space
from experiments.camera.operation import RATE, in_motion, life_line, over_life
from experiments.camera.settings import CameraReportConfig
from experiments.harness.progress import Progress
from experiments.harness.sections import numbers_of
from experiments.harness.system import forked, prompt_import
from experiments.harness.what_if import judge
from experiments.laboratory.bench.checks import focus_remark
from experiments.laboratory.sensor_prediction import CameraPrediction, longest_trail_px, predict_camera

MANUFACTURED_LENS_REQUIREMENTS = ("lsfe_before_arcsec", "lsfe_after_arcsec")
"""Requirements on manufactured lenses alone."""
SLOW_IMPORTS = ("experiments.camera.experiment", "experiments.harness.document", "xarray", "astropy.table")
"""Modules of the report, imported after the answer is printed."""


def run(config: CameraReportConfig, *, progress: Progress) -> dict[str, Any]:
    """Prediction and its changes, the answer, then temperatures and frames."""
    with progress.stage("predict"):
        prediction = predict_camera(config)
    for remark in _remarks(prediction):
        progress.note(remark)
    required = limits(config)
    thermal_required = bool(required.keys() & ThermalRange.__dataclass_fields__.keys())
    records: list[Any] = [*prediction.records, coverage(prediction)]
    rows = answer_rows(prediction, judge(required, numbers_of(*records)), [])
    pending = (VERDICT, ADVICE) if thermal_required or RATE in required else (ADVICE,)
    progress.answer("\n".join(line for name, line in rows.items() if name not in pending))
    changes: list[Swing] = []
    motion = None
    with forked(partial(temperatures, config), niceness=3) as over_temperature:
        if config.tornado.parameters:
            keys = parameters(config, prediction)
            with progress.stage("what to change", total=1 + 2 * len(keys)) as stage:
                changes = swings(config, prediction, advance=stage.advance)
        if thermal_required:
            temperature, thermal = _await_temperatures(over_temperature, progress)
            records.append(thermal)
        if RATE in required:
            with progress.stage("motion"):
                motion = in_motion(prediction, required)
            records += [motion] if motion is not None else []
        rows = answer_rows(prediction, judge(required, numbers_of(*records)), changes)
        progress.answer("\n".join(rows[name] for name in pending))
        with progress.stage("motion and life"):
            motion = in_motion(prediction, required) if motion is None else motion
            life = over_life(prediction, required)
        if life is not None:
            progress.answer(life_line(life))
        identified = None
        if not config.predict_only:
            with progress.stage("lost in space", total=config.lost.attitudes) as stage:
                identified = lost_in_space(prediction, advance=stage.advance)
        for module in SLOW_IMPORTS:
            prompt_import(module)
        if not thermal_required:
            temperature, thermal = _await_temperatures(over_temperature, progress)
    from experiments.camera.experiment import predicted

    sections: dict[str, Any] = predicted(prediction, thermal, *(record for record in (motion, identified) if record))
    sections |= {"temperatures": temperature, "thermal": thermal, "changes": changes or None}
    sections |= {"motion": motion, "life": life, "lost_in_space": identified}
    sections |= _manufactured_and_frames(prediction, required, progress)
    judged = {requirement.key for requirement in sections["requirements"]}
    judged |= set(MANUFACTURED_LENS_REQUIREMENTS) if config.manufacture.lenses else set()
    if unjudged := sorted(required.keys() - judged):
        progress.note(f"Not judged, as this run does not predict it: {', '.join(unjudged)}.")
    return sections


def _await_temperatures(
    over_temperature: Callable[[], tuple[Temperatures | None, ThermalRange]], progress: Progress
) -> tuple[Temperatures | None, ThermalRange]:
    with progress.stage("temperature"):
        return over_temperature()


def _remarks(prediction: CameraPrediction) -> list[str]:
    """Remarks on the focus, and on spots that are wider than the centroid window."""
    state = prediction.state
    remark = focus_remark(state.sensor, state.light.wavelength_nm[0], state.fraction)
    margin_px, setting, window_px = longest_trail_px(prediction.config, state)
    too_wide = f"{setting} {window_px} px cuts the spots: they need {math.ceil(window_px - margin_px) // 2 * 2 + 1} px."
    return [*([remark] if remark else []), *([too_wide] if margin_px < 0.0 else [])]


def _manufactured_and_frames(
    prediction: CameraPrediction, required: dict[str, tuple[float, bool]], progress: Progress
) -> dict[str, Any]:
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
            lenses = sections["manufactured"]
            sections["rendered_lenses"] = rendered_lenses(prediction, lenses, advance=stage.advance)
    return sections
