"""Random mutants of the science, and the share of them that the default tests of the same room notice.

``python benchmarks/mutation.py --count 200 --seed 24 --out out/mutation`` needs ``pip install '.[dev,test]'``.

Mutants are those of cosmic-ray: an operator, a comparison, a sign, a number, a truth value or a loop changed. A place
is drawn at random, then the change there; rooms are drawn in proportion to their lines. Left out: annotations,
decorators, messages, refusals (``if ...: raise``), ``__all__``, changes that only end with a TypeError. Each is tried
in a copy of the last commit with the default tests of its room that execute its statement, the fastest first, then with
the rest of the same test files, which share fixtures and caches. Written: ``lines-ROOM.json`` (which test executes
what, and its cost), ``mutants.json``, ``mutants.txt`` (shares by room, then each survivor as a diff). A repeated run
keeps what is killed and tries survivors again; delete ``lines-ROOM.json`` after a change of tests.
"""

from __future__ import annotations

import argparse
import ast
import difflib
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
from typing import Any

import coverage
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ["calib", "render/detector", "optics/rays", *(f"experiments/{name}" for name in ("laboratory", "fisher"))]
ROOMS += ["experiments/turntable", "experiments/temporal"]
NO_SCIENCE = ("__*", "*settings*", "*figures*", "*sketch*", "*tables*", "*quantities*", "*criteria*", "own_frames*")
SYMBOLS = [{"Add", "Sub", "Mul", "Div", "Pow"}, {"BitOr", "BitAnd"}, {"Is", "IsNot"}, {"In", "NotIn"}]
SYMBOLS += [{"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"}, {"UAdd", "USub"}]
OTHERS = ["NumberReplacer", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"]
OTHERS += ["ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "AddNot"]
PYTEST = ["-n", "0", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
LONGEST_S = 60.0
PRELOADED = ["numpy", "xarray", "pydantic", "matplotlib.figure", "astropy.table", "astropy.io.fits", "scipy.stats"]
PRELOADED += ["scipy.optimize", "scipy.interpolate", "scipy.ndimage", "scipy.signal", "scipy.spatial.transform"]
"""What forked processes need not import again; nothing of the house."""
Mutant = dict[str, Any]


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
    status = pytest.main([*PYTEST, f"tests/{room}"], plugins=[plugin])
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


def tried(copy: Path, mutant: Mutant, measured: dict[str, Any]) -> int:
    """Process that runs the tests of a mutant in a copy, until one fails."""
    cost, (head, imported) = measured["cost_s"], statements(mutant["old"])[mutant["line"]]
    by_line = {int(line): names for line, names in measured["lines"].get(mutant["file"], {}).items()}
    reached = {name for line, names in by_line.items() if imported or line in head for name in names if name}
    first = {name for name in cost if reached & {name, name.split("::")[0]}}
    files = sorted({name.split("::")[0] for name in first})
    order = sorted(
        (name for name in cost if name.split("::")[0] in files), key=lambda name: (name not in first, cost[name])
    )
    while sum(cost[name] for name in order) > LONGEST_S:
        order.pop()
    mutant["reached_by"], limit = len(first), int(10 + 2 * sum(cost[name] for name in order))
    write(copy / ".noticed", "")
    write(copy / mutant["file"], mutant["new"])

    def work() -> int:
        sys.dont_write_bytecode = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        resource.setrlimit(resource.RLIMIT_AS, (24 << 30, 24 << 30))
        return int(pytest.main([*PYTEST, "-x", *files], plugins=[Chosen(order, copy / ".noticed")])) if order else 5

    return in_child(copy, work)


def study(copies: list[Path], mutants: list[Mutant], done: dict[str, Mutant], out: Path) -> None:
    """Measure what is executed, then try the mutants, as many at a time as there are copies."""
    os.environ["OPENBLAS_NUM_THREADS"], sys.dont_write_bytecode, measured = "1", False, {}
    for name in PRELOADED:
        import_module(name)
    for room in dict.fromkeys(mutant["room"] for mutant in mutants):
        kept = out / f"lines-{room.replace('/', '-')}.json"
        if not kept.exists():
            os.waitpid(in_child(copies[0], lambda room=room, kept=kept: measure(copies[0], room, kept)), 0)
        measured[room] = json.loads(kept.read_text(encoding="utf-8"))
    waiting, free, running = [one for one in mutants if one["diff"] not in done], list(copies), {}
    while waiting or running:
        if waiting and free:
            copy, mutant = free.pop(), waiting.pop(0)
            running[tried(copy, mutant, measured[mutant["room"]])] = copy, mutant
            continue
        pid, status = os.wait()
        copy, mutant = running.pop(pid)
        code, noticed = os.waitstatus_to_exitcode(status), (copy / ".noticed").read_text(encoding="utf-8")
        mutant["noticed_by"] = "" if code in (0, 5) else noticed or ("time" if code < 0 else "collection")
        mutant["state"] = "killed" if mutant["noticed_by"] else "survived" if mutant["reached_by"] else "not reached"
        write(copy / mutant["file"], mutant.pop("old"))
        done[mutant["diff"]] = {name: value for name, value in mutant.items() if name != "new"}
        (out / "mutants.json").write_text(json.dumps(list(done.values()), indent=1), encoding="utf-8")
        free.append(copy)


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
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=200, help="mutants drawn over all rooms")
    parser.add_argument("--seed", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=1, help="mutants tried at the same time")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, choices=ROOMS, help="only these")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutation")
    options = parser.parse_args()
    out, known = options.out.resolve(), options.out.resolve() / "mutants.json"
    out.mkdir(parents=True, exist_ok=True)
    earlier = json.loads(known.read_text(encoding="utf-8")) if known.exists() else []
    done = {mutant["diff"]: mutant for mutant in earlier if mutant["state"] == "killed"}
    mutants = draw(options.count, options.seed, options.rooms)
    with tempfile.TemporaryDirectory() as folder:
        copies = [Path(folder) / str(job) for job in range(options.jobs)]
        for copy in copies:
            subprocess.run(["git", "worktree", "add", "-q", "--detach", copy, "HEAD"], cwd=ROOT, check=True)
        try:
            study(copies, mutants, done, out)
        finally:
            for copy in copies:
                subprocess.run(["git", "worktree", "remove", "--force", copy], cwd=ROOT, check=True)
    text = report([done[mutant["diff"]] for mutant in mutants], options.seed)
    (out / "mutants.txt").write_text(text, encoding="utf-8")
    print(text.split("\n\n")[0])


if __name__ == "__main__":
    main()
