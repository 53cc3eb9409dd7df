"""The experiments, one package each, and what they share: the laboratory and the frame that makes commands of them."""

import sys
from importlib.util import find_spec
from pathlib import Path

for _name in ("optics", "render", "calib"):  # a user's module of that name makes imports fail in strange ways
    _found = find_spec(_name)
    _file = None if _found is None else _found.origin
    if _file and Path(_file).resolve().parents[1] != Path(__file__).resolve().parents[1]:
        _said = f"{_file} hides the package {_name!r} of starbench; rename it or start elsewhere"
        if sys.argv[:1] == ["-m"]:  # a command is starting
            print(f"error: {_said}", file=sys.stderr)
            raise SystemExit(2)
        raise ImportError(_said)
