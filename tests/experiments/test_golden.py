"""Names and units that readers of a run rely on: keys of ``summary.json``, heads of ECSV files, headings of the report.

``golden/NAME.json`` holds them for every ``--quick`` run. Values are not in it. The runs are those of
``STARBENCH_QUICK_RUNS`` (a folder with one output per experiment), or made here. After a change on purpose::

    python tests/experiments/test_golden.py out    # the outputs of python -m experiments --all --quick
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

GOLDEN = Path(__file__).with_name("golden")
NAMES = sorted(path.stem for path in GOLDEN.glob("*.json"))
HEADING = re.compile(r"<h([12])[^>]*>(.*?)</h\1>", re.S)


def keys_and_units(node, at=""):
    """Key -> unit of a measured value, else the JSON type; members of a list count as one."""
    if isinstance(node, dict) and {"value", "unit"} <= node.keys():
        return {at: f"measured [{node['unit']}]"}
    if isinstance(node, dict):
        parts = [keys_and_units(value, f"{at}.{key}" if at else key) for key, value in node.items()]
    elif isinstance(node, list):
        parts = [keys_and_units(value, f"{at}[]") for value in node] or [{f"{at}[]": "empty"}]
    else:
        number = isinstance(node, (int, float)) and not isinstance(node, bool)
        return {at: "number" if number or node is None else type(node).__name__}
    return {key: unit for part in parts for key, unit in part.items()}


def ecsv_head(path):
    """Columns of an ECSV file, with their units."""
    text = path.read_text(encoding="utf-8")
    units = dict(re.findall(r"^# - \{name: ([^,]+), unit: ([^,]+),", text, re.M))
    names = next(line for line in text.splitlines() if not line.startswith("#")).split(",")
    return [f"{name} [{units[name]}]" if name in units else name for name in names]


def described(folder):
    """What readers rely on in an output folder."""
    page = folder / "report.html"
    headings = [re.sub(r"<[^>]*>", "", text) for _, text in HEADING.findall(page.read_text(encoding="utf-8"))]
    return {
        "results": keys_and_units(json.loads((folder / "summary.json").read_text(encoding="utf-8"))["results"]),
        "ecsv": {path.name: ecsv_head(path) for path in sorted(folder.glob("*.ecsv"))},
        "headings": [re.sub(r"\d[\d.,\u2009]*", "#", text) for text in headings],
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_has_the_names_that_readers_rely_on(quick_run_of, name):
    golden, quick_run = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8")), quick_run_of(name)
    found = described(quick_run)
    for part, expected in golden.items():
        assert found[part] == expected, part
    criteria = json.loads((quick_run / "summary.json").read_text(encoding="utf-8"))["criteria"]
    assert all(one["value"] is not None for one in criteria)
    assert len({one["name"] for one in criteria}) == len(criteria)
    page = (quick_run / "report.html").read_text(encoding="utf-8")
    assert "nan" not in re.sub(r"<svg.*?</svg>|data:[^\"]*", "", page, flags=re.DOTALL).lower().split()


def test_every_experiment_has_its_names():
    from experiments.harness.registry import experiment_names

    assert sorted(experiment_names()) == NAMES


if __name__ == "__main__":
    for folder in sorted(Path(sys.argv[1]).iterdir()):
        if (folder / "summary.json").exists():
            (GOLDEN / f"{folder.name}.json").write_text(
                json.dumps(described(folder), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
            )
