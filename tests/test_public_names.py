"""The packages' own names: they load, they are what completion and help show, and importing a package stays cheap."""

import pydoc
import subprocess
import sys
from importlib import import_module

import pytest

PACKAGES = ("optics", "render", "calib", "experiments")
HEAVY = ("numpy", "scipy", "matplotlib", "mitsuba", "drjit", "astropy", "skimage")


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_loads_is_documented_and_alone_in_the_listing(name):
    package = import_module(name)
    for public in package.__all__:
        value = getattr(package, public)
        if callable(value):
            assert value.__doc__, public
            assert value.__module__.startswith(f"{name}."), public  # where help() says that it lives
    assert sorted(package.__all__) == dir(package)
    modules = {module.split(".")[1] for module in sys.modules if module.startswith(f"{name}.")}
    assert not modules & set(package.__all__)  # which would hide the name
    text = pydoc.plain(pydoc.render_doc(package))
    listed = text[text.index("PACKAGE CONTENTS") :]
    assert [public for public in package.__all__ if public not in listed] == []


def test_importing_the_packages_imports_nothing_heavy():
    code = f"import sys, {', '.join(PACKAGES)}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_sky_and_stars_need_no_mitsuba():
    code = "import sys; from render import load_sky, load_star_sensor; print('mitsuba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
