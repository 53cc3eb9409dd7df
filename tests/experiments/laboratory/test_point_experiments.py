"""The commands temporal, hsfe, distortion and chromatic: a run on few pixels, bad input in one line."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from experiments.chromatic.experiment import field_map
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from experiments.harness.registry import declared

STARS = ["target.rows=2", "target.columns=2", "target.pitch_px=45.1", "target.edge_px=40"]
FEW = {
    "temporal": [*STARS, "frames=20", "draws=10", "brightness.levels=2", "brightness.setting_error_ratio=0"],
    "hsfe": [*STARS, "frames=3", "dark_frames=3", "draws=10", "steps.positions=3"],
    "chromatic": [*STARS, "target.rows=1", "frames=3", "dark_frames=3", "stars.grid=2", "filters.centres_nm=[600,800]"],
    "distortion": ["target.rows=3", "target.columns=3", "target.edge_px=40", "order=1", "map_rows=5", "surveys=4"],
}
PIXEL = {
    "temporal": "test.pixel_arcsec",
    "hsfe": "test.pixel_arcsec",
    "chromatic": "bench.pixel_arcsec",
    "distortion": "target.pixel_arcsec",
}
FEW["chromatic"] += ["decentre.wanted_px=0"]
FEW["distortion"] += ["frames=4", "dark_frames=4", "draws=10", "wide.target.edge_px=20"]


@pytest.mark.parametrize("name", FEW)
def test_a_run_on_few_pixels_by_rays(name, engine, tiny_chip):
    """Every number of the summary is there, and no criterion fails that this sample can judge."""
    wide = ("wide.instrument", "instrument") if name == "distortion" else ("instrument",)
    camera = [f"{table}.{value}" for table in wide for value in (f"detector={tiny_chip}", "diffraction=rays")]
    experiment = declared(name)
    config = load_config(experiment.config, settings=[*FEW[name], *camera, "centroid=cog", "compare=[]"])
    result = import_module(f"experiments.{name}.experiment").run(config, progress=Progress())
    outcome = experiment.outcome(config, result)
    assert [one.name for one in experiment.judge(outcome) if one.failed] == []
    assert np.isfinite(outcome.value(PIXEL[name]))
    if name == "chromatic":  # a panel per lens and pair of bands
        assert len(field_map(outcome).axes) == 2
    if name == "temporal":  # levels without setting error are the ends of the range
        assert [one.signal_e for one in result["levels"]] == pytest.approx([700.0, 20000.0])
