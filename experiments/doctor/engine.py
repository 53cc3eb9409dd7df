"""LLVM, backend, threads and GPU, as a process of its own finds them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from experiments.doctor.finding import Finding

__all__ = ["Probe", "engine_findings"]

KNOWN_LLVM = range(15, 20)
PATIENCE_S = 60.0


class Probe:
    """`experiments.doctor.probe` at work, started at once so that other checks run meanwhile."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | OSError
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "experiments.doctor.probe"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
            )
        except OSError as error:
            self._process = error

    def check(self) -> Iterator[Finding]:
        """Findings about LLVM, the backend, threads and the GPU."""
        if isinstance(self._process, OSError):
            raise self._process
        try:
            output, said = self._process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            output, said = self._process.communicate()
            said += f"\nno answer within {PATIENCE_S:g} s"
        found: dict[str, Any] = {}
        for line in output.splitlines():
            if line.startswith("{"):
                found.update(json.loads(line))
        last = (said.strip().splitlines() or [""])[-1]
        yield from engine_findings(found, self._process.returncode, last)


def engine_findings(found: dict[str, Any], status: int, said: str) -> Iterator[Finding]:
    """What the steps of the probe mean."""
    if "llvm" in found:
        yield _llvm(found)
    yield _backend(found, status, said)
    if "threads" in found:
        yield _threads(found)
    if "driver" in found:
        yield _gpu(found)


def _llvm(found: dict[str, Any]) -> Finding:
    facts = {"version": found["llvm"], "library": found["library"], "known_to_work": list(KNOWN_LLVM)}
    if found["llvm_error"]:
        what, _, advice = found["llvm_error"].partition("; ")
        elsewhere = " (not needed with the GPU)" if found["cuda"] else ""
        state: Any = "note" if found["cuda"] else "fault"
        return Finding(name="LLVM", state=state, text=what + elsewhere, advice=advice, facts=facts)
    text = f"{found['llvm']}, {found['library'] or 'found by Dr.Jit'}"
    span = f"{KNOWN_LLVM[0]} to {KNOWN_LLVM[-1]}"
    if int(found["llvm"].partition(".")[0]) not in KNOWN_LLVM:
        advice = f"versions {span} are known to work; take one of them if a run ends without a word"
        return Finding(name="LLVM", state="note", text=text, advice=advice, facts=facts)
    return Finding(name="LLVM", text=f"{text} ({span} work)", facts=facts)


def _backend(found: dict[str, Any], status: int, said: str) -> Finding:
    facts = {name: found.get(name) for name in ("variant", "variants", "mitsuba", "drjit", "compiled_s")}
    if "variants" in found and found["computed"]:
        variants = ", ".join(name for name in found["variants"] if name.endswith("_ad_mono"))
        text = f"{found['variant']}; a first kernel took {1e3 * found['compiled_s']:.0f} ms"
        return Finding(name="backend", text=f"{text}; variants {variants}", facts=facts)
    what = found.get("error") or said or "it gave no result"
    if what == found.get("llvm_error"):
        return Finding(name="backend", state="fault", text="none: LLVM does not work and there is no GPU", facts=facts)
    if status < 0:
        what = f"the renderer was ended by signal {-status} ({what})"
    what, _, advice = what.partition("; ")
    return Finding(
        name="backend",
        state="fault",
        text=what,
        advice=advice or "see LLVM and packages above; make a new environment if they are as they should be",
        facts=facts,
    )


def _threads(found: dict[str, Any]) -> Finding:
    from experiments.harness.system import processors
    from experiments.harness.threads import THREADS

    mine, there, told = processors(), os.cpu_count() or 1, [name for name in THREADS if os.environ.get(name)]
    text = f"{found['threads']} of Dr.Jit, {mine} of {there} processors for this process"
    text += f"; {', '.join(told)} set" if told else "; one for linear algebra"
    facts = {"drjit": found["threads"], "processors": mine, "all_processors": there, "set": told}
    return Finding(name="threads", text=text, facts=facts)


def _gpu(found: dict[str, Any]) -> Finding:
    driver = found["driver"]
    facts = {"cuda": found["cuda"], "driver": driver}
    if driver is None:
        return Finding(name="GPU", text="no NVIDIA driver here; the processor computes", facts=facts)
    text = f"{', '.join(driver['devices']) or 'no device'}, driver for CUDA {driver['cuda']}"
    if found["cuda"]:
        return Finding(name="GPU", text=f"{text}; cuda_ad_mono is taken unless --backend llvm", facts=facts)
    if not driver["devices"]:
        return Finding(name="GPU", text=f"{text}; the processor computes", facts=facts)
    advice = "update NVIDIA's driver (Dr.Jit needs one for CUDA 11.3 or newer), and look whether nvidia-smi runs"
    return Finding(name="GPU", state="note", text=f"{text}, but Dr.Jit has no CUDA", advice=advice, facts=facts)
