"""The page on what predictions and measurements share: the functions that it begins with exist."""

import ast
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[1]


def defined(module):
    """Qualified names of the functions of a module."""
    tree = ast.parse((ROOT / module.replace(".", "/")).with_suffix(".py").read_text(encoding="utf-8"))
    found = set()
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else []
        found |= {f"{node.name}.{one.name}" for one in inside if isinstance(one, ast.FunctionDef)}
        found |= {node.name} if isinstance(node, ast.FunctionDef) else set()
    return found


def test_every_side_begins_with_a_function_that_exists():
    comparisons = runpy.run_path(str(ROOT / "benchmarks" / "independence.py"))["COMPARISONS"]
    named = [name.split(":") for one in comparisons for name in one.sides()]
    assert len(named) > 2 * len(comparisons)
    assert [name for module, name in named if name not in defined(module)] == []
