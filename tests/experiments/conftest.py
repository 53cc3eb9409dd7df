"""The small real experiment that the tests of the frame run, loaded from its file."""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments.harness.registry import declared, load


@pytest.fixture(scope="session")
def shot_noise():
    """The module ``shot_noise.py`` of this folder."""
    path = Path(__file__).with_name("shot_noise.py")
    spec = importlib.util.spec_from_file_location("shot_noise_for_tests", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def in_words(shot_noise):
    """The same experiment without drawings, which take most of its time."""
    return replace(shot_noise.experiment, report="shot_noise_in_words.md")


@pytest.fixture(scope="session")
def engine():
    """The processor."""
    from render.engine import Engine

    return Engine.start("llvm")


@pytest.fixture(scope="session")
def quick_run_of(tmp_path_factory):
    """``quick_run_of(name)``: output of ``--quick``, of ``STARBENCH_QUICK_RUNS`` (a folder of them) or made here."""
    given, here = os.environ.get("STARBENCH_QUICK_RUNS"), tmp_path_factory.mktemp("quick")

    def folder(name):
        from experiments.__main__ import main

        if not given and not (here / name).exists():
            assert main([name, "--quick", "--out", str(here / name)]) in (0, 1)
        return Path(given or here) / name

    return folder


@pytest.fixture(scope="session")
def star_camera():
    """The default instrument of the experiments."""
    from render.sensor_file.instrument import build_instrument
    from render.sensor_file.tables import InstrumentConfig

    return build_instrument(InstrumentConfig())


@pytest.fixture(scope="session")
def bench_of():
    """A laboratory with three filters; keywords change it."""
    from experiments.laboratory.bench.point_bench import Bench
    from experiments.laboratory.settings.tables import TargetConfig
    from optics.light.band import TopHat
    from optics.light.spectrum import Blackbody

    def make(rows=2, columns=2, centres_nm=(500.0, 600.0, 800.0), reference=1, edge_px=150.0, **changes):
        settings = {
            "target": TargetConfig(rows=rows, columns=columns, edge_px=edge_px),
            "lamp": Blackbody(temperature_k=3000.0),
            "filters": [TopHat(centre_nm=c, width_nm=100.0, edge_nm=10.0, name=f"{c:g} nm") for c in centres_nm],
            "reference": reference,
            "signal_e": 6000.0,
            "frames": 8,
            "dark_frames": 20,
            "window_px": 13,
            "methods": ("epsf",),
        }
        return Bench(**(settings | changes))

    return make


@pytest.fixture(scope="session")
def small_detector(tmp_path_factory):
    """Data file of a smaller detector of the same make: frames that take a test less time and memory."""
    path = tmp_path_factory.mktemp("detector") / "small.toml"
    path.write_text('base = "cmv4000"\nname = "small"\nchip_width_px = 3072\nchip_height_px = 1536\n')
    return path


@pytest.fixture(scope="session")
def small_camera(small_detector):
    """The default lens in front of the small detector."""
    from render.sensor_file.instrument import build_instrument
    from render.sensor_file.tables import InstrumentConfig

    return build_instrument(InstrumentConfig(detector=str(small_detector)))


@pytest.fixture
def traced_once(monkeypatch):
    """Light of point targets that is asked for again, for another chip or other noise, is not traced again."""
    from experiments.laboratory.bench.points import PointScene

    def once(trace):
        kept = {}

        def light(self, direction, *rest):
            camera, bench = self.instrument.camera, self.bench
            key = (id(camera), bench.signal_e, *(one.name for one in bench.filters), direction.tobytes(), *rest)
            if key not in kept:
                kept[key] = camera, trace(self, direction, *rest)  # the camera lives on, and its id with it
            return kept[key][1]

        return light

    for name in ("image", "filter_psfs"):
        monkeypatch.setattr(PointScene, name, once(getattr(PointScene, name)))


@pytest.fixture
def broken(monkeypatch):
    """``broken(function, replacement)``: every module that holds a function gets another in its place."""

    def replace_everywhere(function, replacement):
        for module in list(sys.modules.values()):
            if getattr(module, "__name__", "").startswith(("experiments.", "calib.", "render.")):
                for name in [name for name, value in vars(module).items() if value is function]:
                    monkeypatch.setattr(module, name, replacement)

    return replace_everywhere


@pytest.fixture(scope="session")
def failing():
    """``failing(name, result, config)``: names of the criteria that do not hold for a result of an experiment."""

    def judged(name, result, config=None):
        experiment = declared(name)
        return [one.name for one in experiment.judge(experiment.outcome(config or result.config, result)) if one.failed]

    return judged


def processor_s():
    """Processor time of this process and of its children that have ended: a busy machine does not count."""
    return sum(os.times()[:4])


@pytest.fixture
def refused_by(tmp_path, monkeypatch, capsys):
    """``refused_by(name, argument, ..., settings=(...))``: a command that must change nothing; the one line it says."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments, settings=(), within_s=60.0):
        main = load(name)
        present, start = sorted(path.name for path in tmp_path.iterdir()), processor_s()
        assert main([*arguments, *(word for one in settings for word in ("--set", one))]) == 2
        assert processor_s() - start < within_s
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert sorted(path.name for path in tmp_path.iterdir()) == present
        return said.err

    return run


@pytest.fixture(scope="session")
def tiny_chip(tmp_path_factory):
    """Data file of a detector of 288 x 256 px."""
    chip = tmp_path_factory.mktemp("chip") / "tiny.toml"
    chip.write_text('base = "cmv4000"\nname = "tiny"\nchip_width_px = 288\nchip_height_px = 256\n')
    return chip


@pytest.fixture(scope="session")
def tiny_run(engine, tiny_chip, tmp_path_factory):
    """``tiny_run(name, key=value, ...)``: exit status, folder, records of a run on 288 x 256 px; ``__`` is a dot."""

    def run(name, **settings):
        from experiments.harness.cli import command

        experiment, kept = declared(name), []
        work = experiment.part(experiment.run)

        @functools.wraps(work)
        def keep(config, **keywords):
            kept.extend((work(config, **keywords), config))
            return kept[0]

        given = {"instrument.detector": tiny_chip, **{key.replace("__", "."): value for key, value in settings.items()}}
        texts = [f"{key}={json.dumps(value) if isinstance(value, list) else value}" for key, value in given.items()]
        out = tmp_path_factory.mktemp(name) / "out"
        status = command(replace(experiment, run=keep))(
            [*(part for text in texts for part in ("--set", text)), "--out", str(out)], own_process=False
        )
        results = json.loads((out / "summary.json").read_text(encoding="utf-8"))["results"]
        return SimpleNamespace(status=status, folder=out, result=kept[0], config=kept[1], results=results)

    return run
