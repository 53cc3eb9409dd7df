"""The distortion test from the command line to its report: a marking error that is known gives its own figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.distortion.experiment import axes
from experiments.distortion.settings import Config
from experiments.distortion.wide_field import WIDE, wide_field, wide_run
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.harness.quantities import Outcome
from experiments.harness.sections import judged
from render.engine.random import Streams

pytestmark = pytest.mark.slow  # a whole run

ROWS, COLUMNS, ORDER, SURVEYS, MARKING_ARCSEC = 4, 5, 2, 100, 2.0


@pytest.fixture(scope="module")
def run(tiny_run):
    """Middle of the field, where the lens has next to no distortion, and a target that is badly surveyed."""
    target = {"target__rows": ROWS, "target__columns": COLUMNS, "target__edge_px": 40}
    numbers = {"map_rows": 5, "order": ORDER, "frames": 10, "dark_frames": 40, "surveys": SURVEYS, "draws": 40}
    sensor = {"target__marking_error_arcsec": MARKING_ARCSEC, "instrument__diffraction": "rays"}
    return tiny_run("distortion", **target, **numbers, **sensor, compare=["cog"])


@pytest.fixture(scope="module")
def wide(engine):
    """The wide field of a small run."""
    config = load_config(
        Config, settings=["frames=8", "dark_frames=30", "draws=20", "compare=[]", "wide.instrument.diffraction=rays"]
    )
    return wide_run(config, Streams(3), progress=Progress())


def failing_of(run):
    """Verdicts on the wide field that do not hold."""
    q = axes(Config())
    WIDE.describe(q, wide_field(run))
    outcome = Outcome(config=None, result={"wide": run}, data=q.dataset)
    return [one.name for one in judged({"wide": WIDE}, outcome) if one.failed]


@pytest.mark.parametrize(("factor", "fails"), [(1.0, 0), (1.05, 2), (0.98, 2), (-1.0, 1)])
def test_a_wrong_distortion_in_the_frames_is_noticed(wide, factor, fails):
    """Rationale: frames of another lens. Expected: its distortion times 1.05, 0.98 or -1 fails; its own does not."""
    middle = wide.frames.instrument.camera.centre_px
    place = wide.frames.light.nominal_px - middle
    design = np.zeros((*place.shape, 5))  # shift, scale, roll, cubic
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[..., 2], design[..., 3] = place, np.column_stack([-place[:, 1], place[:, 0]])
    design[..., 4] = place * (place**2).sum(1)[:, None] * 1e-6
    offset = (wide.frames.light.photon_px - wide.frames.light.nominal_px).reshape(-1)
    cubic = np.linalg.lstsq(design.reshape(-1, 5), offset, rcond=None)[0][4] * design[..., 4]
    moved = {m: v + (factor - 1.0) * cubic for m, v in wide.frames.session_px.items()}
    broken = replace(wide, frames=replace(wide.frames, session_px=moved))
    assert len(failing_of(broken)) >= fails
    assert bool(failing_of(broken)) is (fails > 0)


def test_a_quarter_of_what_is_removed_is_noticed(run, failing):
    first, other = run.result["centroiders"]
    wrong = replace(first, all_surveys_arcsec=1.25 * first.all_surveys_arcsec)
    (name,) = failing("distortion", {**run.result, "centroiders": [wrong, other]}, run.config)
    assert name.startswith("ePSF fit: Before, after and removed")
