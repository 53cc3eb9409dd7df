"""What is published: the tested versions of all dependencies, and a source distribution that runs its tests."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
BUILT = ("build", "dist", "out", "*.egg-info", ".git", ".*_cache", "__pycache__", "api", "auto_gallery")


def test_tested_versions_are_allowed_by_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *extras["test"], *extras["dev"], *extras["docs"], *extras["reference"]]
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    versions = {canonicalize_name(name): version for name, _, version in (line.partition("==") for line in lines)}
    for requirement in map(Requirement, asked):
        if requirement.name != "setuptools":  # builds, and is not imported
            assert requirement.specifier.contains(versions[canonicalize_name(requirement.name)]), requirement


@pytest.mark.slow
def test_the_source_distribution_runs_its_tests(tmp_path):
    pytest.importorskip("setuptools", minversion="77")
    source = tmp_path / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*BUILT))
    build = "from setuptools import build_meta as b; b.build_sdist('dist')"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (archive,) = (source / "dist").glob("*.tar.gz")
    with tarfile.open(archive) as files:
        files.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()

    def kept(root: Path) -> set[Path]:
        return {path.relative_to(root) for path in root.glob("tests/**/*.*") if "__pycache__" not in path.parts}

    assert kept(unpacked) == kept(source)
    tests = ["tests/test_architecture.py", "tests/optics/test_attitude.py"]
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n0", *tests], check=False, cwd=unpacked, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout[-2000:]


def test_setup_refuses_an_interpreter_that_is_not_there(tmp_path):
    ran = subprocess.run(
        ["sh", str(ROOT / "setup.sh")],
        env={"PATH": os.environ["PATH"], "PYTHON": "python9", "VENV": str(tmp_path / "v")},
        check=False,
        capture_output=True,
        text=True,
    )
    assert (ran.returncode, ran.stderr) == (2, "setup.sh: PYTHON = python9: no such command\n")
    assert not (tmp_path / "v").exists()
