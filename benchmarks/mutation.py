"""Random mutants of the science, and the share of them that the default tests of the same room notice.

``python benchmarks/mutation.py --count 200 --seed 24 --out out/mutation``

Mutants are those of cosmic-ray: an arithmetic, logical or comparison operator, a sign, a number, a truth value or a
loop changed. A place is drawn at random, then the change there; rooms are drawn in proportion to their lines. Left out:
annotations, decorators, messages, refusals (``if ...: raise``), ``__all__``, changes that only end with a TypeError
(bits of floats). Each mutant is tried in a copy of the last commit with the tests of its room that execute its statement, the
fastest first, then the rest of the same test files (fixtures and caches are shared); slow tests are left out.

Written: ``lines.json`` (statements that each test executes), ``mutants.json``, ``mutants.txt`` (shares by room, then
each survivor as a diff). A repeated run keeps what is killed, and tries survivors again.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from typing import Any

import coverage
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    "calib": "calib",
    "render/detector": "render/detector",
    "optics/rays": "optics/rays",
    **{f"experiments/{name}": f"experiments/{name}" for name in ("laboratory", "fisher", "turntable", "temporal")},
}
NO_SCIENCE = ("__*", "*settings*", "*figures*", "*sketch*", "*tables*", "*quantities*", "*criteria*", "own_frames*")
SYMBOLS = [{"Add", "Sub", "Mul", "Div", "Pow"}, {"BitOr", "BitAnd"}, {"Is", "IsNot"}, {"In", "NotIn"}]
SYMBOLS += [{"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"}, {"UAdd", "USub"}]
OTHERS = ("NumberReplacer", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd")
OTHERS += ("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "AddNot")
PYTEST = ["-n", "0", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
LONGEST_S = 60.0
PRELOADED = [
    "numpy",
    "xarray",
    "pydantic",
    "matplotlib.figure",
    "astropy.table",
    "astropy.io.fits",
    "astropy.coordinates",
]
PRELOADED += [
    f"scipy.{name}" for name in ("linalg", "optimize", "special", "interpolate", "ndimage", "stats", "signal")
]
PRELOADED += ["scipy.spatial.transform", "yaml", "jinja2"]
"""What forked processes need not import again; nothing of the house."""


def operators() -> list[str]:
    """Names of the changes that are made."""

    def kept(name: str) -> bool:
        kind, _, symbols = name.partition("/")[2].partition("Operator_")
        old, _, new = symbols.partition("_")
        return kind in OTHERS or any({old, new} <= group for group in SYMBOLS)

    return [name for name in operator_names() if kept(name)]


def is_left_out(node: ast.AST, parent: ast.AST, field: str) -> bool:
    """Whether a part of the code says something and computes nothing."""
    if isinstance(node, ast.Assign):
        return any(isinstance(target, ast.Name) and target.id.startswith("__") for target in node.targets)
    if isinstance(node, ast.keyword):
        return node.arg in ("strict", "stacklevel", "keepdims")
    if isinstance(parent, ast.If) and field == "test":
        return isinstance(parent.body[-1], ast.Raise)
    return isinstance(node, ast.Raise | ast.JoinedStr) or field in ("annotation", "returns", "decorator_list")


def statements(text: str) -> dict[int, tuple[range, bool] | None]:
    """Lines of the innermost statement around each line, and whether it runs at import; None: left out."""
    lines: dict[int, tuple[range, bool] | None] = {}

    def visit(node: ast.AST, imported: bool) -> None:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
            header = range(node.lineno, max(last, node.lineno) + 1)
            lines.update(dict.fromkeys(header, (header, imported)))
        inner = imported and not isinstance(node, ast.FunctionDef)
        for child in ast.iter_child_nodes(node):
            visit(child, inner)

    visit(ast.parse(text), True)
    return lines


def spans_left_out(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Begin and end, line and column, of the code that says something and computes nothing."""
    return [
        ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
        for parent in ast.walk(ast.parse(text))
        for field, value in ast.iter_fields(parent)
        for node in (value if isinstance(value, list) else [value])
        if isinstance(node, ast.AST) and hasattr(node, "lineno") and is_left_out(node, parent, field)
    ]


def mutants_of(file: str, rng: random.Random) -> Iterator[dict[str, Any]]:
    """One mutant at each place of a file where there are any."""
    text = (ROOT / file).read_text(encoding="utf-8")
    nodes, spans, around = list(ast_nodes(get_ast(text))), spans_left_out(text), statements(text)
    places = defaultdict(list)
    for name in operators():
        operator = get_operator(name)()
        positions = [position for node in nodes for position in operator.mutation_positions(node)]
        for occurrence, (begin, end) in enumerate(positions):
            if begin[0] in around and not any(low <= tuple(begin) and tuple(end) <= high for low, high in spans):
                places[tuple(begin)].append((name, occurrence))
    for (line, _), changes in sorted(places.items()):
        name, occurrence = rng.choice(changes)
        yield {"file": file, "line": line, "operator": name, "occurrence": occurrence}


def draw(count: int, seed: int) -> list[dict[str, Any]]:
    """Mutants drawn at random, rooms in proportion to their lines."""
    rng, files, lines = random.Random(seed), {}, {}
    for room in ROOMS:
        paths = [
            path for path in sorted((ROOT / room).rglob("*.py")) if not any(fnmatch(path.name, p) for p in NO_SCIENCE)
        ]
        files[room] = [str(path.relative_to(ROOT)) for path in paths]
        lines[room] = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)
    drawn = []
    for room, paths in files.items():
        share = max(1, round(count * lines[room] / sum(lines.values())))
        every = [mutant for path in paths for mutant in mutants_of(path, rng)]
        drawn += [{"room": room, **mutant} for mutant in rng.sample(every, min(share, len(every)))]
    for mutant in drawn:
        text = (ROOT / mutant["file"]).read_text(encoding="utf-8")
        changed = mutate_code(text, get_operator(mutant["operator"])(), mutant["occurrence"])
        mutant["text"] = changed
        mutant["diff"] = "\n".join(
            list(difflib.unified_diff(text.splitlines(), changed.splitlines(), n=2, lineterm=""))[2:]
        )
    return drawn


class Executed:
    """A plugin that notes what each test executes and how long it takes, in processor time."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self.measured, self.cost_s = measured, {}

    def pytest_runtest_setup(self, item):
        self.measured.switch_context(item.nodeid.split("::")[0])  # fixtures serve all tests of the file

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        self.measured.switch_context(item.nodeid)
        begin = time.process_time()
        result = yield
        self.cost_s[item.nodeid] = time.process_time() - begin
        return result


def measure(copy: Path, room: str) -> dict[str, Any]:
    """Lines of each file of a room with the tests that execute them; cost of each test."""
    measured = coverage.Coverage(data_file=None, source=[str(copy / room)])
    plugin = Executed(measured)
    measured.start()
    status = pytest.main([*PYTEST, str(Path("tests") / ROOMS[room])], plugins=[plugin])
    measured.stop()
    data = measured.get_data()
    lines = {str(Path(file).relative_to(copy)): data.contexts_by_lineno(file) for file in data.measured_files()}
    return {"status": int(status), "cost_s": plugin.cost_s, "lines": lines}


def in_child(copy: Path, work: Callable[[], int]) -> int:
    """Process of a forked copy of this one that does some work and ends with what it returns."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    try:
        os._exit(work())
    except BaseException:
        os._exit(99)


class Chosen:
    """A plugin that keeps the tests of an order, and notes the first that fails."""

    def __init__(self, order: list[str], noticed: Path) -> None:
        self.rank, self.noticed = {name: rank for rank, name in enumerate(order)}, noticed

    def pytest_collection_modifyitems(self, items):
        items[:] = sorted((item for item in items if item.nodeid in self.rank), key=lambda item: self.rank[item.nodeid])

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.noticed.write_text(report.nodeid, encoding="utf-8")


def try_mutant(copy: Path, mutant: dict[str, Any], measured: dict[str, Any]) -> int:
    """Process that runs the tests of a mutant in a copy; 0 or "no tests": nobody noticed."""
    cost = measured["cost_s"]
    by_line = {int(line): names for line, names in measured["lines"].get(mutant["file"], {}).items()}
    text = (ROOT / mutant["file"]).read_text(encoding="utf-8")
    header, imported = statements(text)[mutant["line"]]
    reached = {name for line in header for name in by_line.get(line, ()) if name}
    if imported:
        reached |= {name for names in by_line.values() for name in names if name}
    first = {name for name in cost if reached & {name, name.split("::")[0]}}
    files = {name.split("::")[0] for name in first}
    order = sorted((name for name in cost if name.split("::")[0] in files), key=lambda name: (name not in first, cost[name]))
    mutant["reached_by"], budget = len(first), 0.0
    for last, name in enumerate(order):
        budget += cost[name]
        if budget > LONGEST_S:
            mutant["left_out"], order = len(order) - last, order[:last]
            break
    (copy / ".noticed").write_text("", encoding="utf-8")
    write(copy / mutant["file"], mutant["text"])

    def work() -> int:
        sys.dont_write_bytecode = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        limit = int(10 + 2 * budget)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        resource.setrlimit(resource.RLIMIT_AS, (24 << 30, 24 << 30))
        signal.alarm(10 * limit)
        kept = sorted({name.split("::")[0] for name in order})
        return int(pytest.main([*PYTEST, "-x", *kept], plugins=[Chosen(order, copy / ".noticed")])) if kept else 5

    return in_child(copy, work)


def write(path: Path, text: str) -> None:
    """Replace a file; its time is one that no compiled file fits."""
    path.write_text(text, encoding="utf-8")
    at = random.randrange(1_000_000_000)
    os.utime(path, (at, at))


def outcome(mutant: dict[str, Any], status: int, noticed: str) -> None:
    """Note who noticed: a test, the import of a test file, or the limit of time."""
    code = os.waitstatus_to_exitcode(status)
    if code in (0, 5):
        mutant["noticed_by"] = ""
    elif code < 0:
        mutant["noticed_by"] = f"ended by signal {-code}"
    else:
        mutant["noticed_by"] = noticed or f"exit status {code}"


def report(mutants: list[dict[str, Any]], seed: int) -> str:
    """Shares by room, then the survivors."""
    lines = [f"{len(mutants)} mutants, seed {seed}", "", f"{'room':<24}drawn killed survived  not reached  killed %"]
    counts = Counter((mutant["room"], state(mutant)) for mutant in mutants)
    for room in [*ROOMS, "all"]:
        killed, lived, lost = (
            sum(
                n
                for (where, what), n in counts.items()
                if where in (room, *(ROOMS if room == "all" else ())) and what == of
            )
            for of in ("killed", "survived", "not reached")
        )
        drawn = killed + lived + lost
        lines.append(f"{room:<24}{drawn:5d} {killed:6d} {lived:8d} {lost:12d} {100 * killed / max(drawn, 1):9.0f}")
    for mutant in mutants:
        if state(mutant) != "killed":
            lines += [
                "",
                f"{state(mutant)}: {mutant['file']}:{mutant['line']} ({mutant['reached_by']} tests)",
                mutant["diff"],
            ]
    return "\n".join(lines) + "\n"


def state(mutant: dict[str, Any]) -> str:
    """What became of a mutant."""
    return "killed" if mutant["noticed_by"] else "survived" if mutant["reached_by"] else "not reached"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=200, help="mutants drawn")
    parser.add_argument("--seed", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=1, help="mutants tried at the same time")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), choices=list(ROOMS), help="only try these")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutation")
    options = parser.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    known = json.loads((out / "mutants.json").read_text()) if (out / "mutants.json").exists() else []
    killed = {mutant["diff"]: mutant for mutant in known if mutant["noticed_by"]}
    mutants = [mutant for mutant in draw(options.count, options.seed) if mutant["room"] in options.rooms]
    with tempfile.TemporaryDirectory() as folder:
        copies = [Path(folder) / str(job) for job in range(options.jobs)]
        for copy in copies:
            subprocess.run(["git", "worktree", "add", "-q", "--detach", copy, "HEAD"], cwd=ROOT, check=True)
        try:
            study(copies, mutants, killed, out)
        finally:
            for copy in copies:
                subprocess.run(["git", "worktree", "remove", "--force", copy], cwd=ROOT, check=True)
    done = [killed.get(mutant["diff"], mutant) for mutant in mutants]
    (out / "mutants.txt").write_text(report(done, options.seed), encoding="utf-8")
    print(report(done, options.seed).split("\n\n")[1])


def study(copies: list[Path], mutants: list[dict[str, Any]], killed: dict[str, Any], out: Path) -> None:
    """Measure what is executed, then try the mutants, several at a time."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    sys.dont_write_bytecode, measured = False, {}
    for name in PRELOADED:
        import_module(name)
    for room in dict.fromkeys(mutant["room"] for mutant in mutants):
        kept = out / f"lines-{room.replace('/', '-')}.json"
        if not kept.exists():

            def work(room: str = room, kept: Path = kept) -> int:
                kept.write_text(json.dumps(measure(copies[0], room)), encoding="utf-8")
                return 0

            os.waitpid(in_child(copies[0], work), 0)
        measured[room] = json.loads(kept.read_text(encoding="utf-8"))
    waiting, free, running = [one for one in mutants if one["diff"] not in killed], list(copies), {}
    while waiting or running:
        if waiting and free:
            copy, mutant = free.pop(), waiting.pop(0)
            running[try_mutant(copy, mutant, measured[mutant["room"]])] = copy, mutant
            continue
        pid, status = os.wait()
        copy, mutant = running.pop(pid)
        outcome(mutant, status, (copy / ".noticed").read_text(encoding="utf-8"))
        write(copy / mutant["file"], (ROOT / mutant["file"]).read_text(encoding="utf-8"))
        mutant.pop("text")
        killed[mutant["diff"]] = mutant
        (out / "mutants.json").write_text(json.dumps(list(killed.values()), indent=1), encoding="utf-8")
        free.append(copy)


if __name__ == "__main__":
    main()
