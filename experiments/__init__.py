"""The experiments, one package each, with their common laboratory and harness.

Commands (``python -m experiments.NAME``) run them; `run_experiment` does the same from Python and returns their
numbers, tables and figures. `predict_sensor` states what the star sensor of a file will do.
"""

import os
import signal
import sys
import threading
from importlib.util import find_spec
from pathlib import Path


def _leave(number: int, frame: object) -> None:
    os.write(2, b"interrupted; nothing was written\n")
    os._exit(130)


_script = Path(*sys.argv[:1]).stem == "starbench" and "--multiprocessing-fork" not in sys.orig_argv  # no worker of it
_command = sys.argv[:1] == ["-m"] or _script

if _command and threading.current_thread() is threading.main_thread():  # a command is starting
    # imports take a second, and an interrupt amid them would end in a traceback; the command takes over from here
    signal.signal(signal.SIGINT, _leave)

for _name in ("optics", "render", "calib"):  # a user's module of that name makes imports fail in strange ways
    _found = find_spec(_name)
    if _found and _found.origin and Path(_found.origin).resolve().parents[1] != Path(__file__).resolve().parents[1]:
        _said = f"{_found.origin} hides the package {_name!r} of starbench; rename it or start elsewhere"
        if not _command:
            raise ImportError(_said)
        print(f"error: {_said}", file=sys.stderr)
        raise SystemExit(2)


def _no_such_module() -> None:
    """Error for an unknown module (``-m experiments.camra``), with the nearest name."""
    words = [word.removeprefix("-m") for word in sys.orig_argv[1:]]
    name = next((word.removeprefix("experiments.") for word in words if word.startswith("experiments.")), "")
    home = Path(__file__).parent
    if "." in name or not name or (home / name / "__main__.py").exists() or (home / f"{name}.py").exists():
        return
    from optics.errors import unknown_name

    known = [path.parent.name for path in home.glob("*/__main__.py")]
    other = (home / name / "command.py").exists()
    said = f"{name} is run by: python -m experiments {name}" if other else unknown_name("experiment", name, known)
    print(f"error: {said}", file=sys.stderr)
    raise SystemExit(2)


if sys.argv[:1] == ["-m"]:
    _no_such_module()

import lazy_loader  # noqa: E402  # after the signal is in hand

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
