"""Who may know whom, and what keeps a file readable; read from the sources, nothing is imported."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("optics", "render", "calib", "experiments")
FILES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
ENGINE = {"mitsuba", "drjit"}

# What a room's modules may not import. calib may know render.records, and nothing else of render.
FORBIDDEN = {
    "optics": {"render", "calib", "experiments", *ENGINE},
    "render": {"calib", "experiments"},
    "calib": {"render", "experiments", *ENGINE},
    "experiments": set(),
}
ALLOWED = {"calib": {"render.records"}}

# Rooms of a package, lowest first: a module imports from its own room and from rooms to the left of a "<" before it.
# Rooms between two "<" know nothing of each other. A new room (or module at the top) has to be put in its place here.
ORDER = {
    "optics": "arrays errors forbes units < attitude distortion_polynomial field_map fits frames interpolation"
    " record_files records stellar_aberration textfile < validate < response settings < glass < files < lens light"
    " < rays < lens_file < export waves < figures frame_html lens_study",
    "render": "engine records < catalogue detector motion < camera < fits sensor sky tracing"
    " < field_response plugins sensor_file < baffle bench bodies forward psf_lattice < observation < simulator",
    "calib": "directional fitting flags < photometry records < cameras measure < attitude detector psf"
    " < accuracy calibration figures",
}
# What experiments share is below them; experiments know nothing of each other's inside.
SHARED = {"harness", "laboratory", "reduce"}
EXPERIMENTS = {path.parent.name for path in ROOT.glob("experiments/*/__init__.py")} - SHARED
ORDER["experiments"] = f"harness < laboratory < reduce < doctor frame {' '.join(sorted(EXPERIMENTS))} < __main__"
# Names that one room may take from another one in spite of the order, by the importing room.
EXCEPTIONS: dict[str, set[str]] = {
    "experiments.harness": {"experiments"}  # where the registry looks for them
}
# What an experiment may take of another one, whose inside it does not know: its declaration, to run it and read its
# numbers, tables and figures by name.
DECLARATION = re.compile(r"experiments\.\w+\.(settings|experiment)\.(Config|experiment|run)")
LINES = 800


IMPORT = re.compile(r"^[ \t]*((?:from[ \t]+\S+[ \t]+)?import[ \t]+(?:\([^)]*\)|.*))", re.MULTILINE)
DYNAMIC = re.compile(r"(?:import_module|__import__)\(\s*[\"']([\w.]+)")


@cache
def imported(source, package):
    """Full dotted names of all modules that a source text imports, wherever the statement stands."""
    names = set(DYNAMIC.findall(source))
    for node in ast.walk(ast.parse("\n".join(IMPORT.findall(source)))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return names


def violations(source, room, package=None):
    """Forbidden modules that a source text of a room imports."""
    return sorted(
        name
        for name in imported(source, package or room)
        if name.split(".")[0] in FORBIDDEN[room]
        and not any(name == allowed or name.startswith(f"{allowed}.") for allowed in ALLOWED.get(room, ()))
    )


def room_of(name):
    """Package and room of a dotted name: its first two parts."""
    package, _, rest = name.partition(".")
    return package, rest.partition(".")[0]


def arrows_up(source, module, order=None, exceptions=None):
    """What the source text of a module imports from rooms of its package that do not stand below its own."""
    package, room = room_of(module)
    levels = [level.split() for level in (order or ORDER[package]).split("<")]
    below = {other for level in levels[: [room in level for level in levels].index(True)] for other in level}
    allowed = (EXCEPTIONS if exceptions is None else exceptions).get(f"{package}.{room}", set())
    return sorted(
        name
        for name in imported(source, module.rpartition(".")[0])
        if room_of(name)[0] == package and room_of(name)[1] not in {room, *below} and name not in allowed
    )


def needs(module, package, source, known):
    """Modules of this project that a source text imports: themselves, or the ones that hold what it imports."""
    names = {name if name in known else name.rpartition(".")[0] for name in imported(source, package)}
    return {name for name in names if name in known and name != module}


def circle(graph):
    """Modules that need each other all around, in order; None where there are none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def calls_set_variant(source):
    """Whether ``set_variant`` is mentioned in code (comments and docstrings do not count)."""
    return "set_variant" in source and any(
        (isinstance(node, ast.Attribute) and node.attr in ("set_variant", "scoped_set_variant"))
        or (isinstance(node, ast.ImportFrom) and any("set_variant" in alias.name for alias in node.names))
        for node in ast.walk(ast.parse(source))
    )


def label(path):
    return path.relative_to(ROOT).as_posix()


def test_no_module_needs_one_that_needs_it():
    """Wherever the import statement stands: one in a function hides a circle and does not open it."""
    modules = {}
    for path in FILES:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        package = name.rpartition(".")[0]
        modules[name.removesuffix(".__init__")] = (package, path.read_text(encoding="utf-8"))
    graph = {module: needs(module, package, source, modules) for module, (package, source) in modules.items()}
    assert circle(graph) is None
    assert graph["render.forward"] >= {"render.camera", "optics.errors"}


def test_a_circle_is_seen():
    sources = {"a.b": "def f():\n    from a.c import g\n", "a.c": "from a import d\n", "a.d": "import a.b\n"}
    assert set(circle({name: needs(name, "a", text, sources) for name, text in sources.items()})) == set(sources)
    del sources["a.d"]
    assert circle({name: needs(name, "a", text, sources) for name, text in sources.items()}) is None


def test_imports_stay_in_bounds():
    found = {}
    for path in FILES:
        *package, _ = path.relative_to(ROOT).parts
        found[label(path)] = violations(path.read_text(encoding="utf-8"), package[0], ".".join(package))
    assert {name: imports for name, imports in found.items() if imports} == {}


@pytest.mark.parametrize(
    ("source", "room", "expected"),
    [
        ("import mitsuba as mi", "optics", ["mitsuba"]),
        ("def f():\n    import drjit.llvm", "optics", ["drjit.llvm"]),
        ("from render import records", "optics", ["render.records"]),
        ("from render.records import Frame", "calib", []),
        ("from render.engine import Engine", "calib", ["render.engine.Engine"]),
        ("from render import records, detector", "calib", ["render.detector"]),
        ("from .render import sky", "calib", []),  # calib.render would be calib's own
        ("import importlib; importlib.import_module('calib.fit')", "render", ["calib.fit"]),
        ("from experiments.harness.cli import command", "render", ["experiments.harness.cli.command"]),
        ("from optics import trace\nfrom .records import Frame", "render", []),
    ],
)
def test_the_rule_sees_what_it_should(source, room, expected):
    assert violations(source, room) == expected


@pytest.mark.parametrize("package", [package for package in ORDER if package != "experiments"])
def test_every_room_has_its_place(package):
    listed = ORDER[package].replace("<", " ").split()
    inside = [p for p in (ROOT / package).iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()]
    assert sorted(listed) == sorted(p.stem for p in inside if p.stem != "__init__")
    row = f"| `{package}/` | {ORDER[package]} |"
    assert row in (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


ORDERED = [path for path in FILES if len(path.relative_to(ROOT).parts) > 2 or path.stem != "__init__"]


def test_no_arrow_back_up():
    found = {}
    for path in ORDERED:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        arrows = arrows_up(path.read_text(encoding="utf-8"), module)
        found[module] = [name for name in arrows if not DECLARATION.fullmatch(name)]
    assert {module: names for module, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("source", "module", "expected"),
    [
        ("from house.cellar import wine", "house.kitchen.stove", []),
        ("from house.kitchen.table import plate", "house.kitchen.stove", []),
        ("from .table import plate", "house.kitchen.stove", []),
        ("import house.attic.box", "house.kitchen.stove", ["house.attic.box"]),
        ("def f():\n    from house.hall import coat", "house.kitchen.stove", ["house.hall.coat"]),  # beside it
        ("from house.hall import door", "house.kitchen.stove", []),  # by exception
        ("from house import guest", "house.attic", ["house.guest"]),  # the package itself stands above its rooms
        ("from garden.shed import spade", "house.cellar", []),  # another package: `violations`
    ],
)
def test_the_order_is_seen(source, module, expected):
    exceptions = {"house.kitchen": {"house.hall.door"}}
    assert arrows_up(source, module, "cellar < kitchen hall < attic", exceptions) == expected


def test_only_the_engine_loads_drjit_and_mitsuba_and_sets_the_variant():
    texts = {label(path): path.read_text(encoding="utf-8") for path in FILES}
    assert [name for name, text in texts.items() if calls_set_variant(text)] == ["render/engine/engine.py"]
    for library, door in (("mitsuba", "render/engine/engine.py"), ("drjit", "render/engine/jit.py")):
        users = [name for name, text in texts.items() if any(room_of(i)[0] == library for i in imported(text, "x"))]
        assert users == [door], library
    assert calls_set_variant("import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')")
    assert calls_set_variant("from mitsuba import set_variant")
    assert not calls_set_variant("'''call set_variant'''  # set_variant")


def test_a_class_name_means_one_thing():
    files = {}
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                files.setdefault(node.name, []).append(label(path))
    assert {name: where for name, where in files.items() if len(where) > 1} == {}


def test_tests_are_no_package_and_files_are_short():
    assert list((ROOT / "tests").rglob("__init__.py")) == []
    lines = {label(path): len(path.read_text(encoding="utf-8").splitlines()) for path in (*FILES, *TESTS)}
    assert {name: count for name, count in lines.items() if count >= LINES} == {}


def test_no_pyplot():
    """Figures are objects; pyplot keeps global state and opens windows."""
    users = [
        label(path)
        for path in FILES
        if any(name.startswith("matplotlib.pyplot") for name in imported(path.read_text(encoding="utf-8"), "x"))
    ]
    assert users == []


# --- Physics is library: experiments state settings, an order of calls and sections.

NUMERICAL = re.compile(r"experiments/(harness|laboratory/devices)/")
"""Statistics of verdicts; what a device of the virtual laboratory does."""
BENCH = re.compile(r"experiments/laboratory/(bench|single_star)/")
"""Where frames of the laboratory are rendered and read out."""
IMAGE_FORMING = (
    "render.StarRenderer", "render.expose", "render.forward", "render.plugins", "render.tracing",
    "render.sky.background", "render.bodies.body_image", "render.bodies.mesh_image", "render.bodies.sphere_image",
    "render.bodies.ghost_sources", "render.detector.chain", "render.detector.cosmic_rays",
    "render.detector.cosmic_ray_charge",
    "render.detector.diffusion", "render.detector.readout",
)  # fmt: skip
NUMERICS = {"einsum", "fft", "linalg", "polyfit", "polynomial", "polyval"}
FUNCTIONS = {
    *("arccos", "arcsin", "arctan", "arctan2", "convolve", "cos", "cross", "cumsum", "dot", "exp", "gradient"),
    *("histogram", "hypot", "interp", "log", "log10", "matmul", "median", "outer", "percentile", "quantile", "sin"),
    *("sqrt", "std", "tan", "tensordot", "trapezoid", "var"),
}
ARITHMETIC = ast.Mult | ast.Div | ast.Pow | ast.MatMult | ast.Mod | ast.FloorDiv
MOST_ARITHMETIC = 12
"""Products, quotients, powers and elementary functions in a function of an experiment; an estimator or a law of physics
has more. Conversions of units, counts of work and axes of figures stay below."""


def inside(function):
    """Nodes of a function, without those of functions and classes defined in it."""
    waiting = list(ast.iter_child_nodes(function))
    while waiting:
        node = waiting.pop()
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node
            waiting.extend(ast.iter_child_nodes(node))


def arithmetic(function):
    """How many operations of mathematics stand in a function."""
    operators = (n for n in inside(function) if isinstance(n, ast.BinOp | ast.AugAssign))
    calls = (n for n in inside(function) if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute))
    return sum(isinstance(n.op, ARITHMETIC) for n in operators) + sum(n.func.attr in FUNCTIONS for n in calls)


def physics(source, bench=False):
    """What a source text of an experiment holds that belongs to the library; a bench forms images."""
    tree = ast.parse(source)
    names = imported(source, "experiments")
    found = {n for n in names if n.startswith("scipy") and not n.startswith("scipy.spatial.transform.Rotation")}
    found |= {n for n in names if n.startswith("numpy.") and n.split(".")[1] in NUMERICS}
    if not bench:
        found |= {n for n in names if any(n == m or n.startswith(f"{m}.") for m in IMAGE_FORMING)}
    found |= {f"np.{n.attr}" for n in ast.walk(tree) if isinstance(n, ast.Attribute) and n.attr in NUMERICS}
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    return sorted(found) + [
        f"{f.name}: {arithmetic(f)} operations" for f in functions if arithmetic(f) > MOST_ARITHMETIC
    ]


def test_physics_is_library():
    """An estimator, the formation of an image, a law of physics: callable and tested without a run."""
    found = {}
    for path in (ROOT / "experiments").rglob("*.py"):
        if not NUMERICAL.match(label(path)):
            found[label(path)] = physics(path.read_text(encoding="utf-8"), bool(BENCH.match(label(path))))
    assert {name: what for name, what in found.items() if what} == {}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from scipy.optimize import least_squares", ["scipy.optimize.least_squares"]),
        ("def f():\n    import scipy.special as s", ["scipy.special"]),
        ("from scipy.spatial.transform import Rotation", []),
        ("from numpy import linalg", ["numpy.linalg"]),
        ("import numpy as n\nn.linalg.lstsq(a, b)", ["np.linalg"]),
        ("from render import observe, expose", ["render.expose"]),
        ("from render.detector.readout import expose as e", ["render.detector.readout.expose"]),
        ("from render.detector.spec import load_detector", []),
        ("from importlib import import_module\nimport_module('render.tracing.tracer')", ["render.tracing.tracer"]),
        ("def fit(a):\n    return " + " * ".join("a" * 15), ["fit: 14 operations"]),
        ("def f(a):\n    def g(b):\n        return b * b\n    return a * g(a)", []),
        ("def f(a):\n    return " + " + ".join(["np.sqrt(a)"] * 13), ["f: 13 operations"]),
    ],
)
def test_physics_is_seen(source, expected):
    assert physics(source) == expected


def test_a_bench_forms_images_but_solves_nothing():
    assert physics("from render.forward import StarRenderer", bench=True) == []
    assert physics("from scipy.optimize import brentq", bench=True) == ["scipy.optimize.brentq"]
