"""Choosing the engine: what is missing or wrong becomes one line that says what to install."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refuses

from optics.errors import BackendError
from render.engine import Engine, jit, llvm
from render.engine.llvm import check_llvm, find_llvm, packaged

ROOT = Path(__file__).parents[3]
PROGRAM = """
import sys
from optics.errors import BackendError
from render.engine import Engine, jit, llvm
from render.engine.llvm import llvm_version
try:
    print(Engine.start(sys.argv[1]).variant, llvm_version())
except BackendError as error:
    print(error)
    sys.exit(2)
"""


def in_new_process(backend: str, program: str = PROGRAM, **environment: str) -> subprocess.CompletedProcess[str]:
    """Dr.Jit looks for LLVM once per process, so each case needs its own."""
    return subprocess.run(
        [sys.executable, "-c", program, backend],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_missing_llvm_is_one_line_with_the_install_command(tmp_path):
    done = in_new_process("llvm", DRJIT_LIBLLVM_PATH=str(tmp_path / "libLLVM.so"))
    assert done.returncode == 2
    assert done.stderr == ""  # Dr.Jit's own two lines do not reach the user
    assert done.stdout.count("\n") == 1
    assert "install" in done.stdout
    assert "LLVM" in done.stdout
    assert "does not exist" in done.stdout


@pytest.mark.slow
def test_dr_jit_is_silent_whatever_is_imported_first(tmp_path):
    program = f"import render.tracing.rays.kernel, render.detector.chain\n{PROGRAM}"
    done = in_new_process("llvm", program, DRJIT_LIBLLVM_PATH=str(tmp_path / "libLLVM.so"))
    assert (done.returncode, done.stderr, done.stdout.count("\n")) == (2, "", 1)


@pytest.mark.slow
def test_file_that_is_no_library(tmp_path):
    path = tmp_path / "libLLVM.so"
    path.write_text("not a shared object")
    done = in_new_process("auto", DRJIT_LIBLLVM_PATH=str(path))
    assert done.returncode == 2
    assert "could not be loaded" in done.stdout


@pytest.mark.slow
def test_library_known_only_by_its_numbered_name(tmp_path):
    real = find_llvm(["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib/llvm-*/lib", "/usr/lib64"])
    if real is None:
        pytest.skip("no LLVM library under the usual folders")
    version = int("".join(filter(str.isdigit, real.name.split("LLVM")[1]))[:2])
    alias = tmp_path / f"libLLVM-{version}.so"
    alias.symlink_to(real)
    assert find_llvm([tmp_path]) == alias
    done = in_new_process("llvm", DRJIT_LIBLLVM_PATH=str(alias))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.split()[0] == "llvm_ad_mono"
    assert done.stdout.split()[1].startswith(f"{version}.")


def test_newest_usable_library_is_found_by_name(tmp_path):
    for name in ("libLLVM-14.so.1", "libLLVM-15.so", "libLLVM.so.19.1", "libLLVM-C.so", "libLLVM-99.txt"):
        (tmp_path / name).touch()
    assert find_llvm([tmp_path]) == tmp_path / "libLLVM.so.19.1"
    (tmp_path / "libLLVM.so.19.1").unlink()
    assert find_llvm([tmp_path, "", tmp_path / "absent"]) == tmp_path / "libLLVM-15.so"
    (tmp_path / "libLLVM-15.so").unlink()
    assert find_llvm([tmp_path]) is None


@pytest.mark.parametrize(
    ("listed", "package"),
    [
        ("libllvm13 libllvm15 libllvm16 libllvm19 libllvmlibc-19-dev libllvm-19-ocaml-dev", "libllvm19"),  # Debian 12
        ("libllvm17t64 libllvm18 libllvm19 libllvm22", "libllvm19"),  # Debian 13
        ("libllvm11 libllvm14 libllvm15", "libllvm15"),  # Ubuntu 22.04
        ("libllvm14t64 libllvm15t64 libllvm17t64", "libllvm17t64"),  # Ubuntu 24.04 without its updates
        ("libllvm14 libllvmspirvlib15", None),
    ],
)
def test_the_package_of_a_distribution_is_found(listed, package):
    assert packaged(listed.split()) == package


@pytest.mark.parametrize(("version", "drjit"), [((15, 0, 6), "1.4.0"), ((19, 1, 7), "1.4.0"), ((19, 1, 7), "1.5.0")])
def test_llvm_that_works_is_accepted(version, drjit):
    check_llvm(version, drjit)


def test_cuda_without_a_gpu():
    import drjit as dr

    Engine.start("auto")
    if dr.has_backend(dr.JitBackend.CUDA):
        pytest.skip("this machine has a GPU")
    refuses(BackendError, "use backend 'llvm'", Engine.start, "cuda")


def test_second_start_keeps_the_variant():
    first = Engine.start("llvm")
    mi = first.mitsuba
    plugin = mi.Float
    assert Engine.start("llvm") == Engine.start("auto") == Engine.active() == first
    assert mi.variant() == first.variant == "llvm_ad_mono"
    assert first.mitsuba.Float is plugin


LAZY = """
import sys
from render.engine import Engine, jit, llvm
Engine.start("llvm")
assert (Engine.active().types.Float64(2.0) * 3.0)[0] == 6.0
assert Engine.active().arrays.sqrt(Engine.active().types.Float64(9.0))[0] == 3.0
assert "mitsuba" not in sys.modules
mi = Engine.active().mitsuba
assert mi.variant() == "llvm_ad_mono"
Engine.start("auto", suffix="ad_rgb")  # with Mitsuba there, at once
assert mi.variant() == "llvm_ad_rgb" and Engine.active().suffix == "ad_rgb"
mi.set_variant("llvm_ad_spectral")  # whoever sets the variant is followed
assert Engine.active().variant == "llvm_ad_spectral"
mi.set_variant("scalar_rgb")
try:
    Engine.active()
except Exception as error:
    print(error)
print(Engine.start("llvm").mitsuba.variant())
"""


@pytest.mark.slow
def test_mitsuba_comes_when_it_is_asked_for_and_its_variant_is_the_engine():
    done = subprocess.run([sys.executable, "-c", LAZY], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    refused, variant = done.stdout.splitlines()
    assert "scalar_rgb is active; call render.engine.Engine.start" in refused
    assert variant == "llvm_ad_mono"


@pytest.mark.parametrize(
    ("system", "there", "found"),
    [
        ("darwin", ["llvm@19/lib/libLLVM.dylib", "llvm@17/lib/libLLVM.dylib"], "llvm@19/lib/libLLVM.dylib"),
        ("darwin", ["Cellar/llvm/18.1.8/lib/libLLVM.dylib", "llvm@14/lib/libLLVM.dylib"], "Cellar/llvm/18.1.8/lib"),
        ("darwin", ["llvm-16/lib/libLLVM-16.dylib", "llvm/lib/libLLVM.so.19"], "llvm-16/lib/libLLVM-16.dylib"),
        ("win32", ["LLVM/bin/LLVM-C.dll", "LLVM/bin/LLVM-C.lib"], "LLVM/bin/LLVM-C.dll"),
        ("win32", ["LLVM/bin/libLLVM.so.19"], None),
    ],
)
def test_names_of_the_library_on_other_systems(tmp_path, monkeypatch, system, there, found):
    monkeypatch.setattr(sys, "platform", system)
    for name in there:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    library = find_llvm([(tmp_path / name).parent for name in there])
    assert (library is None) if found is None else library.relative_to(tmp_path).as_posix().startswith(found)


@pytest.mark.parametrize(
    ("system", "packages", "advice"),
    [
        ("darwin", None, "brew install llvm@19"),
        ("win32", None, "winget install --id LLVM.LLVM --version 19.1.7"),
        ("linux", "libllvm14 libllvm15", "apt-get install -y libllvm15"),
        ("linux", "", "apt-get update, then a package from libllvm15 to libllvm19"),
        ("linux", None, "dnf install llvm-libs"),
    ],
)
def test_advice_names_the_system_s_command(monkeypatch, system, packages, advice):
    def listed(*_, **__):
        if packages is None:
            raise FileNotFoundError
        return subprocess.CompletedProcess([], 0, stdout=packages)

    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(llvm.subprocess, "run", listed)
    assert advice in llvm.install_advice()


def test_library_beside_the_interpreter_is_pointed_to(monkeypatch, tmp_path):
    """As of conda, where Dr.Jit does not look; a library that Dr.Jit finds, or a named one, is left alone."""
    (tmp_path / "libLLVM.so.19.1").touch()
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "restored after the test")
    del os.environ["DRJIT_LIBLLVM_PATH"]
    monkeypatch.setattr(llvm, "_found_by_drjit", lambda: True)
    llvm.point_to_llvm()
    assert "DRJIT_LIBLLVM_PATH" not in os.environ
    monkeypatch.setattr(llvm, "_found_by_drjit", lambda: False)
    llvm.point_to_llvm()
    assert os.environ["DRJIT_LIBLLVM_PATH"] == str(tmp_path / "libLLVM.so.19.1")


@pytest.mark.parametrize(
    ("reason", "advice"),
    [("libtinfo.so.6: cannot open shared object file", "apt-get install libtinfo6"), ("no such", "pip install 'drjit")],
)
def test_why_dr_jit_cannot_be_loaded(reason, advice):
    assert advice in jit._why_not(ImportError(reason))


def test_what_compiled_code_prints_is_captured():
    with jit._caught_stderr() as printed:
        os.write(2, b"from below Python")
    assert printed == ["from below Python"]
