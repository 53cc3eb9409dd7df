"""The container recipe names what is there: it can only be built where images can be had."""

import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

from experiments.doctor import KNOWN_LLVM

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "container"
RECIPE = re.sub(r"\\\n", " ", (FOLDER / "Containerfile").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_what_is_copied_is_there_and_is_all_that_the_package_is_made_of():
    copied = {name for line in re.findall(r"^COPY (?!--from)(.*) \S+$", RECIPE, re.M) for name in line.split()}
    assert [name for name in copied if not (ROOT / name).exists()] == []
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests"}
    assert packages | {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"]} == copied
    ignored = (FOLDER / "Containerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert copied == {line[1:] for line in ignored if line.startswith("!")}


def test_versions_and_extras_are_those_of_the_project():
    (llvm,) = re.findall(r"\blibllvm(\d+)\b", RECIPE)
    assert int(llvm) in KNOWN_LLVM
    for extra in re.findall(r"'\.\[([\w,]+)\]'", RECIPE):
        assert set(extra.split(",")) <= set(PROJECT["optional-dependencies"])
    assert set(re.findall(r'ENTRYPOINT \["(\w+)"', RECIPE)) == set(PROJECT["scripts"])


def test_it_runs_without_rights_and_leaves_no_lists_behind():
    last = RECIPE[RECIPE.rindex("FROM ") :]
    assert re.search(r"^USER (?!root|0)\w+$", last, re.M)
    assert last.index("USER") < last.index("ENTRYPOINT")
    for line in re.findall(r"^RUN .*apt-get install.*$", RECIPE, re.M):
        assert "--no-install-recommends" in line
        assert "rm -rf /var/lib/apt/lists" in line
    assert not [one for one in re.findall(r"^ARG BASE=(\S+)$", RECIPE, re.M) if fnmatch(one, "*:latest")]
