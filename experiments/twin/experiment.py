"""From frames to a twin: the sequence of a run.

Frames are read or rendered (`folder`, `synthetic`), solved (`night`) and measured (`measure`, `pipeline`), every frame
is held out in turn (`hold_out`, `compare`), and the twin is written (`twin`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments.harness.progress import Progress
from experiments.twin.comparison_results import agreement_lines
from experiments.twin.folder import night_frames
from experiments.twin.hold_out import held_out
from experiments.twin.pipeline import black_level, measure_night
from experiments.twin.prescription import fit_lens_pose, write_prescription
from experiments.twin.report import records
from experiments.twin.settings import TwinConfig
from experiments.twin.synthetic import render_night
from experiments.twin.twin import AssumedCamera, build_twin, write_twin
from render.engine.random import Streams

WINDOW_PX = 11


def run(config: TwinConfig, *, progress: Progress) -> dict[str, Any]:
    """Frames read or rendered, the camera measured, each frame held out, the twin built."""
    truth = None if config.frames else render_night(config.night, config.seed, progress)
    if truth is None:
        with progress.stage("frames read"):
            frames, notes = night_frames(config.frames)
    else:
        frames, notes = truth.frames, ()
    for note in notes:
        progress.note(note)
    night, identifier = measure_night(frames, config, progress, truth=truth, notes=notes)
    assumed = AssumedCamera(
        pixel_pitch_mm=night.pitch_mm,
        exposure_s=night.exposure_s,
        saturation_dn=night.saturation_dn,
        aperture_mm=config.camera.aperture_mm,
    )
    compared = held_out(
        night.prepared,
        night.fit,
        assumed=assumed,
        realisations=config.realisations,
        streams=Streams(config.seed).child("twin"),
        identifier=identifier,
        progress=progress,
        black_level_dn=black_level(config, truth),
    )
    name = config.camera.name or (Path(config.frames).resolve().name if config.frames else "rendered camera")
    twin = build_twin(
        compared.bias.corrected(night.fit),
        assumed,
        name=name,
        source=f"{len(night.rows)} frames of {name}",
        taken=night.taken,
        hot_fraction=float(night.prepared.hot.mean()),
    )
    pose = None
    if config.prescription:
        with progress.stage("focus and tilt of the known lens"):
            pose = fit_lens_pose(Path(config.prescription), night.fit, night.prepared.limit_mag)
    return records(night, compared, twin, truth=truth, name=name, pose=pose, prescription=config.prescription)


def files(result: Mapping[str, Any], folder: Path) -> None:
    """The twin's sensor file, with the lens and the detector that it names."""
    products = result["products"]
    write_twin(
        products.twin,
        folder,
        faintest_mag=round(float(products.limit_mag) + 0.5, 1),
        window_px=WINDOW_PX,
        name=products.name,
        compared=agreement_lines(result["comparison"], result["detections"]),
    )
    if products.prescription:
        write_prescription(Path(products.prescription), result["detector_pose"], folder)
