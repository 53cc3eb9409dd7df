"""Small frames of the Pleiades, for tests of datasets: settings, a run of the command, digests of its files."""

import hashlib
import json
from pathlib import Path

SETTINGS = (
    "instrument.lens=star_camera_206mm instrument.width_px=192 instrument.height_px=128 nodes=3 verify.frames=0 "
    "catalogue.faintest_mag=10 pointing.kind=cone pointing.ra_deg=56.75 pointing.dec_deg=24.12 pointing.radius_deg=0.1"
)
OPTIONS = [word for setting in SETTINGS.split() for word in ("--set", setting)]


def run(folder: Path, *more: str, frames: int = 3) -> int:
    """Exit status of the command in this process."""
    from experiments.dataset.settings import main

    return main([*OPTIONS, "--workers", "1", "--frames", str(frames), "--out", str(folder), *more])


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every frame and truth file."""
    files = [*(folder / "frames").iterdir(), *(folder / "truth").iterdir()]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(files)}


def results(folder: Path) -> dict:
    """Numbers of the section of frames."""
    frames = json.loads((folder / "summary.json").read_text())["results"]["frames"]
    return {name: number.get("value") for name, number in frames.items()}
