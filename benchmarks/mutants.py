"""Which tests, and which criteria of the experiments, notice a broken equation: equations are broken one at a time.

Run from the repository root: ``python benchmarks/mutants.py`` (an hour on two cores, four minutes with
``--tests-only``); the table goes to docs/mutants.md. The equations stand in benchmarks/mutants.toml. Every one is
broken in a copy of the tracked files; the repository itself is not touched. The text to break has to occur exactly once
in its file, or the run ends before it begins: the list cannot rot.

Noticed by tests: one of the named test files fails, which passes unbroken. Noticed by criteria: a criterion of
``python -m experiments.NAME --quick`` does not hold that holds unbroken, or the run ends with an error; the experiments
are tried in the order of the list until one notices (``--every``: all of them). What was found is kept in
out/mutants.json: a run that is repeated does what is missing, with ``--again`` also what nobody noticed.

mutmut and cosmic-ray are maintained and were not taken. They change operators and constants wherever they stand, in
messages and choices of speed as well, so that most of what survives is no error; they do not know which change makes
another equation of it (two axes exchanged, a covariance turned the wrong way, a factor of a document left out). And
they judge by tests alone, where the question here is also whether an experiment that reports agreement would have
reported it all the same.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
RESULTS, PAGE = ROOT / "out" / "mutants.json", ROOT / "docs" / "mutants.md"
TEST_FAILED, NOT_COLLECTED = 1, 2
LONGEST_S = 1800.0
ENDS = "the run ends: "
JUDGED = """
import json, sys, tempfile
from importlib import import_module
from experiments.harness.config import load_config
from experiments.harness.progress import Progress
from render.engine import Engine
declared = import_module(f"experiments.{sys.argv[1]}.experiment").experiment
config = load_config(declared.config, quick=declared.quick)
Engine.start("auto")
with tempfile.TemporaryDirectory() as folder:
    output = {"output": declared.output(f"{folder}/out", config)} if declared.output else {}
    outcome = declared.outcome(config, declared.run(config, progress=Progress(), **output))
    print(json.dumps([criterion.name for criterion in declared.judge(outcome) if not criterion.passed]))
"""
"""``--quick`` without what it writes and draws."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One broken equation.

    Attributes
    ----------
    name, file : str
        Its name; the file, from the repository root.
    equation, source, fault : str
        What stands there, where it comes from, what becomes of it.
    old, new : str
        Text of the file, occurring once, and what replaces it.
    tests, experiments : list of str
        Test files that should notice, experiments whose criteria could.
    """

    name: str
    file: str
    equation: str
    source: str
    fault: str
    old: str
    new: str
    tests: list[str]
    experiments: list[str]

    def broken(self, text: str) -> str:
        """The file's text with the equation broken.

        Raises
        ------
        ValueError
            If the equation does not occur exactly once.
        """
        found = text.count(self.old)
        if found != 1:
            raise ValueError(f"{self.name}: {self.old!r} occurs {found} times in {self.file}; it has to occur once")
        return text.replace(self.old, self.new)


def read_list() -> list[Mutant]:
    """All mutants, in the order of the list."""
    return [Mutant(**entry) for entry in tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]]


class Copy:
    """A copy of the tracked files, in which one equation at a time is broken."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._changes = folder, 0
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
        for name in filter(None, listed.stdout.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / name, folder / name)

    def write(self, file: str, text: str) -> None:
        """Replace a file; its time is one that it never had, so that no compiled file fits it."""
        path = self.folder / file
        path.write_text(text, encoding="utf-8")
        self._changes += 1
        at = path.stat().st_mtime + 10 * self._changes
        os.utime(path, (at, at))

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """A Python command in the copy; one that does not end is an error of its own."""
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        command = [sys.executable, *arguments]
        try:
            return subprocess.run(
                command,
                cwd=self.folder,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=LONGEST_S,
            )
        except subprocess.TimeoutExpired:
            return subprocess.CompletedProcess(command, -1, "", f"not done after {LONGEST_S:g} s")


def failing_test(copy: Copy, files: Sequence[str]) -> str:
    """Name of the first test that fails, or "" if all pass."""
    done = copy.run("-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--no-header", "--tb=no", *files)
    if done.returncode == 0:
        return ""
    if done.returncode not in (TEST_FAILED, NOT_COLLECTED):
        sys.exit(f"pytest {' '.join(files)}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return lines[0].split(" ", 1)[1].split(" - ")[0] if lines else "collection"


def failing_criteria(copy: Copy, experiment: str) -> list[str]:
    """Names of the criteria that do not hold in a quick run; its last line, if it ends with an error."""
    done = copy.run("-c", JUDGED, experiment)
    if done.returncode:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:]
        return [f"{ENDS}{' '.join(last).strip()[:160]}"]
    return list(json.loads(done.stdout.splitlines()[-1]))


class Study:
    """The runs, and what they found."""

    def __init__(self, results: Path, mutants: Sequence[Mutant], *, every: bool) -> None:
        self.path, self.mutants, self.every = results, mutants, every
        self._lock = threading.RLock()
        self.found: dict[str, Any] = json.loads(results.read_text(encoding="utf-8")) if results.exists() else {}

    def entry(self, mutant: Mutant) -> dict[str, Any]:
        """What is known of a mutant; nothing, if its change is not the one that was made then."""
        change = {"file": mutant.file, "old": mutant.old, "new": mutant.new}
        with self._lock:
            known = self.found.get(mutant.name)
            if known is None or known["change"] != change:
                self.found[mutant.name] = known = {"change": change, "criteria": {}}
            return known

    def save(self) -> None:
        """Write what was found so far, at once or not at all."""
        with self._lock:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            beside = self.path.with_suffix(".part")
            beside.write_text(json.dumps(self.found, indent=1, ensure_ascii=False), encoding="utf-8")
            beside.replace(self.path)

    def forget_missed(self) -> None:
        """Let what nobody noticed be tried again, and the unbroken runs with it."""
        self.found.pop("unbroken", None)
        for entry in map(self.entry, self.mutants):
            if not entry.get("test"):
                entry.pop("test", None)
            entry["criteria"] = {name: failed for name, failed in entry["criteria"].items() if failed}

    def tests(self, mutant: Mutant, copy: Copy) -> None:
        """Which test notices."""
        entry = self.entry(mutant)
        if "test" not in entry:
            noticed = self._broken(mutant, copy, lambda: failing_test(copy, mutant.tests))
            with self._lock:
                entry["test"] = noticed

    def criteria(self, mutant: Mutant, copy: Copy) -> None:
        """Which criteria notice, experiment by experiment."""
        known = self.entry(mutant)["criteria"]
        for experiment in mutant.experiments:
            if experiment not in known:
                failed = self._broken(mutant, copy, lambda name=experiment: failing_criteria(copy, name))
                unbroken = self.unbroken(experiment, copy) if failed else []
                with self._lock:
                    known[experiment] = [name for name in failed if name not in unbroken]
                    self.save()
            if known[experiment] and not self.every:
                return

    def unbroken(self, experiment: str, copy: Copy) -> list[str]:
        """What does not hold without any mutant; where the run ends with an error, nothing can be said."""
        with self._lock:
            unbroken = self.found.setdefault("unbroken", {})
            if experiment not in unbroken:
                failed = failing_criteria(copy, experiment)
                if failed and failed[0].startswith(ENDS):
                    sys.exit(f"{experiment} without any mutant: {failed[0]}")
                unbroken[experiment] = failed
            return list(unbroken[experiment])

    @staticmethod
    def _broken(mutant: Mutant, copy: Copy, what: Callable[[], Any]) -> Any:
        text = (copy.folder / mutant.file).read_text(encoding="utf-8")
        copy.write(mutant.file, mutant.broken(text))
        try:
            return what()
        finally:
            copy.write(mutant.file, text)


def in_copies(copies: queue.SimpleQueue[Copy], study: Study, work: Callable[..., None], items: Iterable[Any]) -> None:
    """Do work on items, as many at a time as there are copies."""
    todo = list(items)

    def one(item: Any) -> None:
        copy = copies.get()
        try:
            work(item, copy)
        finally:
            copies.put(copy)

    with ThreadPoolExecutor(copies.qsize()) as pool:
        for number, (item, _) in enumerate(zip(todo, pool.map(one, todo), strict=True), 1):
            study.save()
            print(f"{number}/{len(todo)} {getattr(item, 'name', item)}", flush=True)


def unbroken_tests(files: Iterable[str], copy: Copy) -> None:
    """End the run if a test fails without any mutant."""
    failed = failing_test(copy, sorted(set(files)))
    if failed:
        sys.exit(f"{failed} fails without any mutant; nothing can be said with it")


def row(mutant: Mutant, entry: dict[str, Any]) -> str:
    """A line of the table."""
    test = entry.get("test", "")
    test = f"`{test.rsplit('/', 1)[-1].replace('.py::', ': ')}`" if test else "**none**"
    noticed = "; ".join(f"{name}: {failed[0]}" for name, failed in entry["criteria"].items() if failed)
    run, left = list(entry["criteria"]), [name for name in mutant.experiments if name not in entry["criteria"]]
    asked = f"none of {', '.join(run)}" if run else "no experiment is expected to" if not left else ""
    asked += f"{'; ' if asked else ''}not run: {', '.join(left)}" if left else ""
    cells = (
        f"`{mutant.name}` `{mutant.file}`",
        f"{mutant.equation} ({mutant.source})",
        mutant.fault,
        test,
        noticed or asked,
    )
    return f"| {' | '.join(text.replace('|', chr(92) + '|') for text in cells)} |"


def page(study: Study) -> str:
    """The table for the documents."""
    entries = [study.entry(mutant) for mutant in study.mutants]
    by_tests = sum(bool(entry.get("test")) for entry in entries)
    noticed = [any(entry["criteria"].values()) for entry in entries]
    judged = [
        seen or set(mutant.experiments) <= set(entry["criteria"])
        for mutant, entry, seen in zip(study.mutants, entries, noticed, strict=True)
    ]
    left = f"; {judged.count(False)} were not judged" if not all(judged) else ""
    rooms = Counter(mutant.file.split("/")[0] for mutant in study.mutants)
    counts = ", ".join(f"{count} in `{room}`" for room, count in rooms.items())
    lines = [
        "# Broken equations",
        "",
        f"{len(entries)} equations ({counts}), each broken alone by `python benchmarks/mutants.py`.",
        "",
        f"* Noticed by tests: {by_tests} of {len(entries)}. The first test that fails is named.",
        f"* Noticed by criteria of quick runs: {sum(noticed)} of {sum(judged)}, "
        f"{sum(noticed) / max(sum(judged), 1):.0%}{left}.",
        "",
        "The first criterion that does not hold is named; after *none of* stand the experiments that were run.",
        "",
        "| name, file | equation | broken | test that notices | criterion that notices |",
        "|---|---|---|---|---|",
        *map(row, study.mutants, entries),
    ]
    return "\n".join(lines) + "\n"


def options() -> argparse.Namespace:
    """What was asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", action="append", metavar="NAME", help="this mutant alone (may be repeated); no table is written"
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--tests-only", action="store_true", help="tests, without the experiments; no table is written")
    which.add_argument("--criteria", action="store_true", help="experiments, without the tests")
    which.add_argument("--table", action="store_true", help="nothing; write the table from what is known")
    parser.add_argument(
        "--every", action="store_true", help="all experiments of a mutant, not up to the first that notices"
    )
    parser.add_argument("--again", action="store_true", help="also what nobody noticed before")
    parser.add_argument("--jobs", type=int, default=2, help="at the same time (default 2)")
    parser.add_argument(
        "--results", type=Path, default=RESULTS, help="what was found so far (default out/mutants.json)"
    )
    return parser.parse_args()


def main() -> None:
    """Break, run, write."""
    asked, mutants = options(), read_list()
    unknown = set(asked.only or ()) - {mutant.name for mutant in mutants}
    if unknown:
        sys.exit(f"no mutant is called {', '.join(sorted(unknown))}")
    for mutant in mutants:
        mutant.broken((ROOT / mutant.file).read_text(encoding="utf-8"))
    chosen = [mutant for mutant in mutants if not asked.only or mutant.name in asked.only]
    study = Study(asked.results, chosen, every=asked.every)
    if asked.again:
        study.forget_missed()
    with tempfile.TemporaryDirectory() as folder:
        copies: queue.SimpleQueue[Copy] = queue.SimpleQueue()
        for number in range(0 if asked.table else asked.jobs):
            copies.put(Copy(Path(folder) / str(number)))
        if not (asked.criteria or asked.table):
            todo = [mutant for mutant in chosen if "test" not in study.entry(mutant)]
            if todo:
                copy = copies.get()
                unbroken_tests((file for mutant in todo for file in mutant.tests), copy)
                copies.put(copy)
            in_copies(copies, study, study.tests, todo)
        if not (asked.tests_only or asked.table):
            in_copies(copies, study, study.criteria, chosen)
    for mutant in chosen:
        entry = study.entry(mutant)
        print(f"{mutant.name:28s} {entry.get('test') or '-':90s} {json.dumps(entry['criteria'], ensure_ascii=False)}")
    if not (asked.only or asked.tests_only):
        PAGE.write_text(page(study), encoding="utf-8")


if __name__ == "__main__":
    main()
