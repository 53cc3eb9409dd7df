"""From frames to a twin: the sequence of a run.

Frames are read or rendered (`folder`, `synthetic`), solved (`solve`), measured (`camera`, `psf`, `photometry` and
`calib.detector.sky_transfer`, by `measure` and `pipeline`), every frame is held out in turn (`hold_out`), and the twin
is written (`twin`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from experiments.harness.progress import Progress
from experiments.twin.classify import Told, tell_apart
from experiments.twin.folder import night_frames
from experiments.twin.hold_out import HeldOut, held_out
from experiments.twin.pipeline import Reduced, black_level, reduce_night
from experiments.twin.prescription import fit_lens_pose, write_prescription
from experiments.twin.report import Sections, compared_words
from experiments.twin.settings import Config
from experiments.twin.synthetic import KnownNight, render_night
from experiments.twin.twin import Assumed, Twin, build_twin, write_twin
from render.engine.random import Streams

WINDOW_PX = 11


def run(config: Config, *, progress: Progress) -> dict[str, Any]:
    """Read or render, solve, measure, hold out, compare."""
    truth: KnownNight | None = None
    if config.frames:
        with progress.stage("frames read"):
            frames, notes = night_frames(config.frames)
    else:
        truth, notes = render_night(config.night, config.seed, progress), ()
        frames = truth.frames
    for note in notes:
        progress.note(note)
    reduced, solver = reduce_night(frames, config, progress, truth=truth, notes=notes)
    assumed = Assumed(
        pixel_pitch_mm=reduced.pitch_mm, exposure_s=reduced.exposure_s, aperture_mm=config.camera.aperture_mm
    )
    compared = held_out(
        reduced.known,
        reduced.whole,
        assumed=assumed,
        saturation_dn=reduced.saturation_dn,
        realisations=config.realisations,
        streams=Streams(config.seed).child("twin"),
        solve=lambda seen: solver.identify(seen)[0].ok,
        progress=progress,
        black_level_dn=black_level(config, truth),
    )
    whole = compared.bias.off(reduced.whole)
    name = config.camera.name or (Path(config.frames).resolve().name if config.frames else "rendered camera")
    twin = build_twin(
        whole,
        assumed,
        name=name,
        source=f"{len(reduced.known.night)} frames of {name}",
        taken=reduced.taken,
        saturation_dn=reduced.saturation_dn,
        hot=int(reduced.known.hot.sum()),
    )
    told = _told(reduced, compared)
    # what is folded into the twin's light makes up for its PSF: the zero point is that of the stars
    whole = replace(whole, photometry=reduced.whole.photometry)
    pose = None
    if config.prescription:
        with progress.stage("focus and tilt of the known lens"):
            pose = fit_lens_pose(Path(config.prescription), reduced.whole, reduced.known.limit_mag)
    return Sections(
        reduced=reduced,
        whole=whole,
        compared=compared,
        twin=twin,
        told=told,
        truth=truth,
        name=name,
        pose=pose,
        prescription=config.prescription,
    ).records()


def files(result: Mapping[str, Any], folder: Path) -> None:
    """The twin's sensor file, with the lens and the detector that it names."""
    kept = result["kept"]
    twin: Twin = kept.twin
    write_twin(
        twin,
        folder,
        faintest_mag=round(float(kept.limit_mag) + 0.5, 1),
        window_px=WINDOW_PX,
        name=kept.name,
        compared=compared_words(result["comparison"], result["detected"]),
    )
    if kept.prescription:
        write_prescription(Path(kept.prescription), result["pose"], folder)


def _told(reduced: Reduced, compared: HeldOut) -> Told | None:
    """Separability of real and rendered stars."""
    real = [(one.image, stats) for one, stats in zip(reduced.known.night.frames, compared.real, strict=True)]
    rendered = list(zip(compared.images, compared.sets[0], strict=True))
    return tell_apart(real, rendered, reduced.known.limit_mag - 1.0)
