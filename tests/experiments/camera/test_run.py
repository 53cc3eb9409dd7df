"""A run without frames from end to end: answer, sections, figures."""

from dataclasses import replace

import pytest
from small_sensors import ideal_lens, sensor

from experiments.camera.experiment import SECTIONS
from experiments.camera.run import run
from experiments.camera.settings import CameraReportConfig, experiment
from experiments.harness.progress import Progress


@pytest.fixture(scope="module")
def quiet_run():
    """Configuration, sections and printed lines."""
    config = CameraReportConfig(
        **sensor(320, ideal_lens(12.0, 1.6, 5.0), diffraction="rays"),
        predict_only=True,
        window_px=9,
        centroid="windowed",
        sky={"attitudes": 10},
        motion={"points": 2},
        thermal={"points": 2},
        tornado={"parameters": ("instrument.exposure_s",)},
        life={"years": 1.0, "contamination": 0.1},
        requirements={"nea_arcsec": 100.0, "update_rate_hz": 6.0, "focus_shift_um": 1e3, "sun_exclusion_deg": 5.0},
    )
    progress, printed = Progress(), []
    progress.say = printed.append
    return config, run(config, progress=progress), "\n".join(printed)


def test_the_answer_line_by_line(quiet_run):
    _, sections, printed = quiet_run
    lines = printed.splitlines()
    assert max(map(len, lines)) <= 84  # with the line on the catalogue that ends
    assert sections["setup"].requirements_missed == 1  # 5 Hz at an exposure of 0.2 s
    for name in ("Sensor", "Limiting magnitude", "Attitude", "Requirements", "Change first", "End of life"):
        assert sum(line.startswith(name) for line in lines) == 1, name
    assert "missed: update_rate_hz" in printed


def test_every_section_with_a_record_is_drawn(quiet_run):
    config, sections, _ = quiet_run
    assert sections["lost_in_space"] is None
    assert sections["coverage"].guide_stars_mean_per_frame > 0.0
    outcome = experiment.outcome(config, sections)
    drawn = {
        f"{name}.{key}": figure(replace(outcome, section=name))
        for name, section in SECTIONS.items()
        if sections.get(name) is not None
        for key, figure in section.figures.items()
    }
    assert {"setup.lens", "setup.spots", "attitudes.sky_distributions", "changes.what_to_change"} <= set(drawn)
    assert all(figure.axes for figure in drawn.values())
