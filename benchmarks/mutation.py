"""Random mutants of the science, and the fraction detected by the default tests of the same room.

``python benchmarks/mutation.py --count 200 --seed 24 --out out/mutation`` needs ``pip install '.[dev,test]'``.

Mutants are those of cosmic-ray: an operator, a comparison, a sign, a number, a truth value or a loop changed. A place
is drawn at random, then the change there; rooms are drawn in proportion to their lines. Left out: annotations,
decorators, messages, refusals (``if ...: raise``), ``__all__``, changes that only end with a TypeError. Each is tried
in a copy of the last commit with the default tests of its room that execute its statement, the fastest first, then with
the rest of the same test files, which share fixtures and caches. Written: ``lines-ROOM.json`` (which test executes
what, and its cost), ``mutants.jsonl``, ``mutants.txt`` (shares by room, then each survivor as a diff). A repeated run
keeps killed mutants and tries survivors again; delete ``lines-ROOM.json`` after a change of tests.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import gc
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import coverage
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
STUDIES = ["laboratory", "reduce", "fisher", "turntable", "temporal", "acf", "cube", "skycal", "hsfe", "distortion"]
STUDIES += ["chromatic", "budget", "camera", "dataset", "twin"]
ALSO = {"experiments/laboratory": ["experiments/camera", "experiments/chromatic", "experiments/distortion"]}
"""Tests of other rooms that a room is tried with: what experiments share is tested where it is used."""
ROOMS = ["calib", "render/detector", "optics/rays", *(f"experiments/{name}" for name in STUDIES)]
NO_SCIENCE = ("__*", "*settings*", "*figures*", "*sketch*", "*tables*", "*quantities*", "*criteria*", "own_frames*")
NO_SCIENCE += ("card*", "command*", "exports*", "folder*", "frames_toml*", "job*", "pictures*", "remote*", "workers*")
NO_SCIENCE += ("truth_files*",)
SAYS = {"curves", "bars", "scatter", "maps", "cloud", "image", "col", "Field", "print", "advance"}
SYMBOLS = [{"Add", "Sub", "Mul", "Div", "Pow"}, {"BitOr", "BitAnd"}, {"Is", "IsNot"}, {"In", "NotIn"}]
SYMBOLS += [{"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"}, {"UAdd", "USub"}]
OTHERS = ["NumberReplacer", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"]
OTHERS += ["ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "AddNot"]
PYTEST = ["-n", "0", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
LONGEST_S = 20.0
PRELOADED = ["numpy", "xarray", "pydantic", "matplotlib.figure", "astropy.table", "astropy.io.fits", "scipy.stats"]
PRELOADED += ["drjit", "click", "pydantic.main", "skimage.measure", "unittest.mock"]
PRELOADED += ["scipy.optimize", "scipy.interpolate", "scipy.ndimage", "scipy.signal", "scipy.spatial.transform"]
"""What forked processes need not import again; nothing of the house."""
Mutant = dict[str, Any]
Job = tuple[Mutant, list[str], int]


def is_made(name: str) -> bool:
    """Whether an operator of cosmic-ray is used."""
    kind, _, symbols = name.partition("/")[2].partition("Operator_")
    old, _, new = symbols.partition("_")
    return kind in OTHERS or any({old, new} <= group for group in SYMBOLS)


def computes_nothing(node: ast.AST, parent: ast.AST, field: str) -> bool:
    """Whether a part of the code only says something."""
    if isinstance(node, ast.Assign):
        return any(isinstance(target, ast.Name) and target.id.startswith("__") for target in node.targets)
    if isinstance(node, ast.keyword):
        return node.arg in ("strict", "stacklevel", "keepdims", "shown")
    if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in SAYS:
        return True
    if isinstance(node, ast.FunctionDef) and node.returns and ast.unparse(node.returns) == "Figure":
        return True
    if isinstance(parent, ast.If) and field == "test":
        return isinstance(parent.body[-1], ast.Raise)
    return isinstance(node, ast.Raise | ast.JoinedStr) or field in ("annotation", "returns", "decorator_list")


def statements(text: str) -> dict[int, tuple[range, bool]]:
    """Lines of the innermost statement around each line (its head, if it has a body), and whether it runs at import."""
    lines: dict[int, tuple[range, bool]] = {}

    def visit(node: ast.AST, imported: bool) -> None:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = max(body[0].lineno - 1 if body else node.end_lineno or 0, node.lineno)
            head = range(node.lineno, last + 1)
            lines.update(dict.fromkeys(head, (head, imported)))
        for child in ast.iter_child_nodes(node):
            visit(child, imported and not isinstance(node, ast.FunctionDef))

    visit(ast.parse(text), True)
    return lines


def mutants_of(file: str, rng: random.Random) -> Iterator[Mutant]:
    """One mutant at each place of a file where there are any."""
    text = (ROOT / file).read_text(encoding="utf-8")
    nodes, around, places = list(ast_nodes(get_ast(text))), statements(text), defaultdict(list)
    spans = [
        ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
        for parent in ast.walk(ast.parse(text))
        for field, value in ast.iter_fields(parent)
        for node in (value if isinstance(value, list) else [value])
        if isinstance(node, ast.AST) and hasattr(node, "lineno") and computes_nothing(node, parent, field)
    ]
    for name in filter(is_made, operator_names()):
        operator = get_operator(name)()
        positions = [position for node in nodes for position in operator.mutation_positions(node)]
        for occurrence, (begin, end) in enumerate(positions):
            star = text.splitlines()[begin[0] - 1][begin[1] :].startswith("*,")  # keywords only: no product
            told = any(low <= tuple(begin) and tuple(end) <= high for low, high in spans)
            if begin[0] in around and not (star or told):
                places[tuple(begin)].append((name, occurrence))
    for (line, _), changes in sorted(places.items()):
        yield {"file": file, "line": line, "change": rng.choice(changes)}


def draw(count: int, seed: int, rooms: list[str]) -> list[Mutant]:
    """Mutants drawn at random, rooms in proportion to their lines."""
    files, drawn = {}, []
    for room in ROOMS:
        paths = [p for p in sorted((ROOT / room).rglob("*.py")) if not any(fnmatch(p.name, one) for one in NO_SCIENCE)]
        files[room] = {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in paths}
    whole = sum(sum(lines.values()) for lines in files.values())
    for room in rooms:
        rng = random.Random(f"{seed} {room}")
        every = [mutant for path in files[room] for mutant in mutants_of(path, rng)]
        share = max(1, round(count * sum(files[room].values()) / whole))
        drawn += [{"room": room, **mutant} for mutant in rng.sample(every, min(share, len(every)))]
    for mutant in drawn:
        text, (name, occurrence) = (ROOT / mutant["file"]).read_text(encoding="utf-8"), mutant.pop("change")
        mutant["old"], mutant["new"] = text, mutate_code(text, get_operator(name)(), occurrence)
        lines = difflib.unified_diff(text.splitlines(), mutant["new"].splitlines(), n=2, lineterm="")
        mutant["diff"] = "\n".join(list(lines)[2:])
    return drawn


class Executed:
    """A plugin that notes what each test executes (fixtures: their file) and its processor time."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self.measured, self.cost_s = measured, {}

    def pytest_runtest_setup(self, item):
        self.measured.switch_context(item.nodeid.split("::")[0])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        self.measured.switch_context(item.nodeid)
        begin = time.process_time()
        result = yield
        self.cost_s[item.nodeid] = time.process_time() - begin
        return result


class Chosen:
    """A plugin that keeps the tests of an order, and notes the one that fails."""

    def __init__(self, order: list[str], noticed: Path) -> None:
        self.rank, self.noticed = {name: rank for rank, name in enumerate(order)}, noticed

    def pytest_collection_modifyitems(self, items):
        items[:] = sorted((item for item in items if item.nodeid in self.rank), key=lambda item: self.rank[item.nodeid])

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.noticed.write_text(report.nodeid, encoding="utf-8")


def in_child(copy: Path, work: Callable[[], int]) -> int:
    """Process of a forked copy of this one that works in a folder and ends with what the work returns."""
    sys.stdout.flush()
    if pid := os.fork():
        return pid
    status = 99
    try:
        os.chdir(copy)
        sys.path.insert(0, str(copy))
        status = work()
    finally:
        os._exit(status)


def measure(copy: Path, room: str, kept: Path) -> int:
    """Write the lines of each file of a room with the tests that execute them, and the cost of each test."""
    measured = coverage.Coverage(data_file=None, source=[str(copy / room)])
    plugin = Executed(measured)
    measured.start()
    status = pytest.main([*PYTEST, *(f"tests/{one}" for one in [room, *ALSO.get(room, [])])], plugins=[plugin])
    measured.stop()
    data = measured.get_data()
    lines = {str(Path(file).relative_to(copy)): data.contexts_by_lineno(file) for file in data.measured_files()}
    kept.write_text(json.dumps({"cost_s": plugin.cost_s, "lines": lines}), encoding="utf-8")
    return int(status)


def write(path: Path, text: str) -> None:
    """Replace a file; its time is one that no compiled file fits."""
    path.write_text(text, encoding="utf-8")
    at = random.randrange(1_000_000_000)
    os.utime(path, (at, at))


def chosen(mutant: Mutant, measured: dict[str, Any]) -> tuple[list[str], int]:
    """Tests of a mutant, in their order, and the processor time they may take [s]."""
    cost, (head, imported) = measured["cost_s"], statements(mutant["old"])[mutant["line"]]
    by_line = {int(line): names for line, names in measured["lines"].get(mutant["file"], {}).items()}
    reached = {name for line, names in by_line.items() if imported or line in head for name in names if name}
    first = {name for name in cost if reached & {name, name.split("::")[0]}}
    files = {name.split("::")[0] for name in first}
    order = sorted(
        (name for name in cost if name.split("::")[0] in files), key=lambda name: (name not in first, cost[name])
    )
    while sum(cost[name] for name in order) > LONGEST_S:
        order.pop()
    mutant["reached_by"], mutant["imported"] = len(first), imported
    return order, int(10 + 2 * sum(cost[name] for name in order))


def limited(limit_s: int) -> None:
    """Bound this process's time and memory, and let it say nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    resource.setrlimit(resource.RLIMIT_AS, (24 << 30, 24 << 30))


def afresh(copy: Path, mutant: Mutant, order: list[str], limit_s: int) -> int:
    """Try a mutant of what runs at import: everything is imported anew."""

    def work() -> int:
        limited(limit_s)
        files = sorted({name.split("::")[0] for name in order})
        return int(pytest.main([*PYTEST, "-x", *files], plugins=[Chosen(order, copy / ".noticed")]))

    return waited(in_child(copy, work))


def waited(pid: int) -> int:
    """Exit status of a process."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class Patched:
    """A plugin that tries mutants in forked copies of a session that has collected its tests and run none.

    Functions get the code of the mutant; modules imported later read it from the file.
    """

    def __init__(self, copy: Path, jobs: Iterator[Job], done: Callable[[Job, int], None]) -> None:
        self.copy, self.jobs, self.done, self.chosen = copy, jobs, done, None

    def pytest_runtestloop(self, session):
        functions = [one for one in gc.get_objects() if isinstance(one, FunctionType)]
        for job in self.jobs:
            mutant, order, limit_s = job

            def work(mutant=mutant, order=order, limit_s=limit_s) -> int:
                limited(limit_s)
                codes = dict(self.codes(compile(mutant["new"], str(self.copy / mutant["file"]), "exec")))
                for one in functions:
                    old = one.__code__
                    if old.co_filename == str(self.copy / mutant["file"]):
                        one.__code__ = codes.get((old.co_qualname, old.co_firstlineno), old)
                items = {item.nodeid: item for item in session.items}
                self.chosen = Chosen([], self.copy / ".noticed")
                todo = [items[name] for name in order if name in items]
                for item, following in zip(todo, [*todo[1:], None], strict=True):
                    item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                return 0

            code = waited(in_child(self.copy, work))
            self.done(job, afresh(self.copy, *job) if code == 99 else code)
        return True

    def codes(self, code: CodeType) -> Iterator[tuple[tuple[str, int], CodeType]]:
        """Code of every function by name and line."""
        for one in code.co_consts:
            if isinstance(one, CodeType):
                yield (one.co_qualname, one.co_firstlineno), one
                yield from self.codes(one)

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.chosen.pytest_runtest_logreport(report)
            os._exit(1)


def study(copy: Path, mutants: list[Mutant], done: dict[str, Mutant], out: Path) -> None:
    """Measure what is executed, room by room, then try the mutants."""
    os.environ["OPENBLAS_NUM_THREADS"], sys.dont_write_bytecode = "1", True
    for name in PRELOADED:
        import_module(name)

    def begin(mutant: Mutant) -> None:
        write(copy / ".noticed", "")
        write(copy / mutant["file"], mutant["new"])

    def end(job: Job, code: int) -> None:
        mutant, _, _ = job
        noticed = (copy / ".noticed").read_text(encoding="utf-8")
        mutant["noticed_by"] = noticed or ("time" if code < 0 else "" if code in (0, 5) else "collection")
        mutant["state"] = "killed" if mutant["noticed_by"] else "survived" if mutant["reached_by"] else "not reached"
        write(copy / mutant["file"], mutant["old"])
        with (out / "mutants.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({k: v for k, v in mutant.items() if k not in ("old", "new")}) + "\n")

    for room in dict.fromkeys(mutant["room"] for mutant in mutants):
        kept = out / f"lines-{room.replace('/', '-')}.json"
        if not kept.exists():
            waited(in_child(copy, lambda room=room, kept=kept: measure(copy, room, kept)))
        measured, jobs = json.loads(kept.read_text(encoding="utf-8")), []
        for mutant in mutants:
            if mutant["room"] == room and mutant["diff"] not in done:
                jobs.append((mutant, *chosen(mutant, measured)))
        for job in jobs:
            if not job[1] or job[0]["imported"]:
                begin(job[0])
                end(job, afresh(copy, *job) if job[1] else 5)
        rest = [job for job in jobs if job[1] and not job[0]["imported"]]

        def each(rest=rest) -> Iterator[Job]:
            for job in rest:
                begin(job[0])
                yield job

        files = sorted({name.split("::")[0] for job in rest for name in job[1]})
        plugin = Patched(copy, each(), end)
        if files:
            waited(in_child(copy, lambda files=files, plugin=plugin: pytest.main([*PYTEST, *files], plugins=[plugin])))


def tried(out: Path) -> dict[str, Mutant]:
    """The last of what was written about each mutant, by its diff."""
    written = out / "mutants.jsonl"
    lines = written.read_text(encoding="utf-8").splitlines() if written.exists() else []
    return {mutant["diff"]: mutant for mutant in map(json.loads, lines)}


def report(mutants: list[Mutant], seed: int) -> str:
    """Shares by room, then the survivors."""
    lines = [f"{len(mutants)} mutants, seed {seed}", f"{'room':<24}drawn killed survived not reached  killed %"]
    for room in [*dict.fromkeys(mutant["room"] for mutant in mutants), ""]:
        counts = Counter(mutant["state"] for mutant in mutants if mutant["room"].startswith(room))
        row = [counts.total(), *(counts[name] for name in ("killed", "survived", "not reached"))]
        lines.append(
            f"{room or 'all':<24}{row[0]:5d} {row[1]:6d} {row[2]:8d} {row[3]:11d} {100 * row[1] / row[0]:9.0f}"
        )
    lived = [mutant for mutant in mutants if mutant["state"] != "killed"]
    lines += [f"\n{m['state']}: {m['file']}:{m['line']} ({m['reached_by']} tests)\n{m['diff']}" for m in lived]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run mutants from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=200, help="mutants drawn over all rooms")
    parser.add_argument("--seed", type=int, default=24)
    parser.add_argument("--rooms", nargs="+", default=ROOMS, choices=ROOMS, help="only these rooms")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutation")
    options = parser.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    mutants = draw(options.count, options.seed, options.rooms)
    killed = {diff: one for diff, one in tried(out).items() if one["state"] == "killed"}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        subprocess.run(["git", "worktree", "add", "-q", "--detach", copy, "HEAD"], cwd=ROOT, check=True)
        try:
            study(copy, mutants, killed, out)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", copy], cwd=ROOT, check=True)
    done = tried(out)
    text = report([done[mutant["diff"]] for mutant in mutants], options.seed)
    (out / "mutants.txt").write_text(text, encoding="utf-8")
    print(text.split("\n\n")[0])


if __name__ == "__main__":
    main()
