"""The tests with point targets on frames from outside (``--frames FOLDER``): no rendering, no truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from experiments.harness.progress import Progress
from experiments.harness.summary import Criterion, Measured
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.distortion_statistics import DistortionStatistics
from experiments.laboratory.frame_folder import FrameFolder, read_folder
from experiments.laboratory.frame_reduction import (
    GridFrames,
    StepFrames,
    TemporalFrames,
    distortion_from_frames,
    hsfe_from_frames,
    temporal_from_frames,
)
from experiments.laboratory.point_settings import PointConfig
from optics.errors import ConfigError

__all__ = ["FolderResult", "Test", "criteria", "outcome", "results", "run_folder"]

Test = Literal["temporal", "hsfe", "distortion"]

_USABLE_FRACTION = 0.9


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderResult:
    """What a folder gave.

    Attributes
    ----------
    test : {"temporal", "hsfe", "distortion"}
        Which reduction.
    config : PointConfig
        Settings; those that describe a rendering have no meaning here.
    methods : tuple of str
        Centroiders, the one that counts first.
    folder : FrameFolder
        As read.
    reduced : TemporalFrames, StepFrames or GridFrames
        By test.
    runtime_s, peak_memory_mb : float
        Of the process up to the end of the run.
    """

    test: Test
    config: PointConfig
    methods: tuple[str, ...]
    folder: FrameFolder
    reduced: TemporalFrames | StepFrames | GridFrames
    runtime_s: float
    peak_memory_mb: float


def run_folder(test: Test, config: PointConfig, *, progress: Progress) -> FolderResult:
    """Read the folder of the configuration and reduce its frames.

    Parameters
    ----------
    test : {"temporal", "hsfe", "distortion"}
        Which reduction.
    config : PointConfig
        With ``frames_folder``, ``window_px`` and the centroiders.
    progress : Progress
        Where to report.

    Raises
    ------
    StarbenchError
        See `read_folder` and the reductions.
    """
    from experiments.harness.provenance import peak_memory_mb, process_seconds

    assert config.frames_folder is not None
    methods = tuple(m for m in config.methods if not needs_epsf(m))
    if not methods:
        raise ConfigError("frames from outside come without a PSF: name a centroid that needs none, e.g. gaussian")
    with progress.stage("read"):
        folder = read_folder(config.frames_folder, window_px=config.window_px)
    reduced: TemporalFrames | StepFrames | GridFrames
    with progress.stage("reduce"):
        if test == "temporal":
            reduced = temporal_from_frames(folder, methods)
        elif test == "hsfe":
            reduced = hsfe_from_frames(folder, methods)
        else:
            reduced = distortion_from_frames(folder, methods, order=getattr(config, "order", 3))
    return FolderResult(
        test=test,
        config=config,
        methods=methods,
        folder=folder,
        reduced=reduced,
        runtime_s=process_seconds(),
        peak_memory_mb=peak_memory_mb(),
    )


def criteria(result: FolderResult) -> list[Criterion]:
    """The frames have to be usable; the numbers are not judged."""
    return [
        Criterion(
            name="frames that gave a position, smallest share over points and centroiders",
            value=min(one.usable_fraction for one in result.reduced.series),
            limit=_USABLE_FRACTION,
            relation=">=",
        )
    ]


def outcome(result: FolderResult) -> tuple[dict[str, Any], list[Criterion]]:
    """Results and criteria for ``summary.json``."""
    return results(result), criteria(result)


def _xy(values: Any) -> dict[str, Any]:
    return {"x": _number(values[0]), "y": _number(values[1])}


def _number(value: Any) -> Any:
    return value if isinstance(value, Measured) else float(value)


def results(result: FolderResult) -> dict[str, Any]:
    """The ``results`` of ``summary.json``."""
    reduced = result.reduced
    if isinstance(reduced, TemporalFrames):
        own = _temporal(reduced, result.methods)
    elif isinstance(reduced, StepFrames):
        own = _steps(reduced, result.methods)
    else:
        own = _grid(reduced, result.methods)
    return {
        "source": "frames",
        **own,
        "series": [
            {"name": one.name, "frames": one.frames, "signal_e": one.signal_e, "usable_fraction": one.usable_fraction}
            for one in reduced.series
        ],
        "points": len(result.folder.series[0].found_px),
        "dark_frames": result.folder.dark_frames,
        "frame_size_px": [result.folder.width_px, result.folder.height_px],
        "pixel_arcsec": reduced.pixel_arcsec,
        "runtime_s": result.runtime_s,
        "peak_memory_mb": result.peak_memory_mb,
    }


def _temporal(reduced: TemporalFrames, methods: tuple[str, ...]) -> dict[str, Any]:
    levels = range(len(reduced.series))
    return {
        "temporal_error_arcsec_3sigma": [{m: _xy(reduced.te_arcsec(m, n)) for m in methods} for n in levels],
        "noise_model_arcsec_3sigma": [{m: _xy(reduced.predicted_te_arcsec(m, n)) for m in methods} for n in levels],
    }


def _steps(reduced: StepFrames, methods: tuple[str, ...]) -> dict[str, Any]:
    return {
        "hsfe_arcsec_3sigma": {m: _xy(reduced.document_arcsec(m)) for m in methods},
        "single_position_arcsec_3sigma": {m: _xy(reduced.halved_arcsec(m)) for m in methods},
        "common_shift_px": [_xy(shift) for shift in reduced.common_px(methods[0])],
    }


def _grid(reduced: GridFrames, methods: tuple[str, ...]) -> dict[str, Any]:
    scale = 3.0 * reduced.pixel_arcsec

    def numbers(one: DistortionStatistics) -> Mapping[str, Any]:
        return {
            "sigma_d": _xy(scale * one.sigma_d_px),
            "sigma_Dd": _xy(scale * one.sigma_left_px),
            "sigma_C1": _xy(scale * one.sigma_c1_px),
        }

    return {
        "distortion_arcsec_3sigma": {
            m: {r: numbers(reduced.statistics(m, r)) for r in reduced.references} for m in methods
        },
        "order": reduced.order,
    }
