"""Tables of frames from outside, for the report and as ECSV files."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome
from experiments.laboratory.own_frames.reduction import StepFrames, TemporalFrames

__all__ = ["tables"]


def tables(outcome: Outcome) -> Mapping[str, Pivot]:
    """Tables by file name."""
    reduced = outcome.result.reduced
    points = Pivot(
        rows="point",
        across="axis",
        columns="mean_px sigma_px",
        caption=f"Centroids of {reduced.series[-1].name}, {outcome.names('method')[0]}; σ of a single frame.",
    )
    if isinstance(reduced, TemporalFrames):
        return {"temporal_error": _TEMPORAL, "points": points}
    if isinstance(reduced, StepFrames):
        caption = f"High spatial frequency error (ACC18 eq. 3-12, 3 σ) from {len(reduced.series)} positions."
        steps = Pivot(rows="method axis", columns="hsfe_arcsec single_arcsec", caption=caption, note=_HALVED)
        return {"hsfe": steps, "positions": _POSITIONS, "points": points}
    grid = Pivot(
        rows="method reference axis",
        columns="sigma_d_arcsec sigma_left_arcsec sigma_c1_arcsec",
        caption=f"Distortion error (ACC18 eq. 17-30, 3 σ), polynomial of order {reduced.order}.",
        note="*nominal*: stated coordinates as they are; *aligned*: shift, roll and scale fitted; *calibrated*: a "
        "camera model from the earlier session.",
    )
    return {"distortion": grid, "points": points}


_TEMPORAL = Pivot(
    rows="series method axis",
    columns="signal_e measured_arcsec noise_model_arcsec ratio",
    caption="Temporal error (ACC18 eq. 1-2, 3 σ) of every series, and what the stated noise of the camera gives.",
    note="Measured values carry the small-sample factor of a standard deviation; it is taken out of *Ratio*.",
)
_HALVED = "*One position*: temporal noise taken away, divided by √2 as if neighbouring positions were independent."
_POSITIONS = Pivot(
    rows="series",
    across="axis",
    columns="frames seen_px commanded_px",
    caption="Shift of the whole image since the first position, as measured and as commanded.",
)
