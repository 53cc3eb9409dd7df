"""Tune an instrument by its physical parameters alone until its predicted budget is the published one.

``python -m experiments.budget.tune --config START.toml --out TUNED.toml`` solves, by least squares on logarithms, for
the signal, the defocus and the decentre of one element: TE follows the signal, HSFE the focus (how sharp the spot is
against the pixel), the chromatic term the decentre. Nothing is rendered but PSFs. With ``--prnu`` the response
non-uniformity is free too. No number of the published budget enters anywhere else.

The steps are made with few draws and an ideal platform; where they end, the full prediction tells by how much each
number was off, and the next round takes that into account.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from experiments.budget.combine import PRINTED, Budget
from experiments.budget.settings import Config
from experiments.harness.config import load_config
from experiments.harness.interrupts import invoke
from experiments.harness.range import with_value
from experiments.harness.run import configuration_file
from experiments.laboratory.published import ACC18_ARCSEC
from optics.arrays import FloatArray

__all__ = ["Tuned", "differences", "tune"]


_AIM = ("TE", "HSFE", "LSFE-S", "total")
ROUNDS, STEPS, DRAWS = 2, 3, 60
STATE_STEP = 0.1
"""Of the differences: large against the noise of the draws."""
_WANTED = {**ACC18_ARCSEC, "total": PRINTED["total"]}
DEFOCUS_STEP_MM = 0.02
"""A change of the defocus that counts as one; half a depth of focus of the lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """What was found."""

    config: Config  # The tuned instrument
    budget: Budget  # Its prediction
    evaluations: int  # Predictions made
    cost: float  # Half the sum of squared logarithms of predicted over published


def _apply(config: Config, values: Mapping[str, float]) -> Config:
    for key, value in values.items():
        config = with_value(config, key, value)
    return config


def _residuals(budget: Budget, short: FloatArray) -> FloatArray:
    """Logarithms of predicted times ``short`` over published (8,): TE, HSFE, chromatic, total, x and y."""
    return np.log(_aimed(budget) * short / np.concatenate([_WANTED[name] for name in _AIM]))


def _aimed(budget: Budget) -> FloatArray:
    """What is aimed at (8,); a statistic that is zero has no logarithm."""
    return np.maximum(np.concatenate([budget[name].arcsec for name in _AIM]), 1e-3)


def _jacobian(residuals: Callable[[FloatArray], FloatArray], state: FloatArray) -> FloatArray:
    """Forward differences (m, k)."""
    here = residuals(state)
    steps = STATE_STEP * np.eye(len(state))
    return np.stack([(residuals(state + step) - here) / STATE_STEP for step in steps], axis=1)


def tune(start: Config, *, prnu: bool = False, report: Callable[[str], None] = lambda line: None) -> Tuned:
    """Find the parameters."""
    from scipy.optimize import least_squares

    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.predict import predict_terms
    from experiments.budget.sweep import counting

    lab = build_laboratory(start)
    signal, share = lab.signal.signal_e, lab.instrument.detector.prnu
    start = with_value(with_value(start, "source.magnitude_mag", None), "source.signal_e", signal)
    count = 0

    def values(state: FloatArray) -> dict[str, float]:
        found = {
            "source.signal_e": float(signal * np.exp(state[0])),
            "instrument.defocus_mm": float(start.instrument.defocus_mm + DEFOCUS_STEP_MM * state[1]),
            "moved.decentre_y_um": float(start.moved.decentre_y_um * np.exp(state[2])),
            "moved.decentre_x_um": float(start.moved.decentre_x_um * np.exp(state[3])),
        }
        return found | ({"detector.prnu": float(share * np.exp(state[4]))} if prnu else {})

    known: dict[tuple[float, ...], Budget] = {}

    def predicted(state: FloatArray) -> Budget:
        nonlocal count
        if tuple(state) in known:
            return known[tuple(state)]
        count += 1
        config = _apply(start, values(state))
        lab = build_laboratory(counting(config))
        budget = predict_terms(lab, draws=DRAWS, step_draws=DRAWS, coarse=True)[config.centroid].budget
        numbers = " ".join(f"{n} {budget[n].arcsec[0]:.2f} {budget[n].arcsec[1]:.2f}" for n in _AIM)
        report(f"{count:3d}  " + "  ".join(f"{k} = {v:.5g}" for k, v in values(state).items()) + f"  ->  {numbers}")
        known[tuple(state)] = budget
        return budget

    state, short = np.zeros(5 if prnu else 4), np.ones(2 * len(_AIM))
    for _ in range(ROUNDS):
        factor = short.copy()
        solved = least_squares(
            lambda s, factor=factor: _residuals(predicted(s), factor),
            state,
            jac=lambda s, factor=factor: _jacobian(lambda t: _residuals(predicted(t), factor), s),
            bounds=(-4.0, 4.0),
            xtol=1e-2,
            ftol=1e-2,
            max_nfev=STEPS,
        )
        state = solved.x
        cheap = _aimed(predicted(state))
        config = _apply(start, {key: float(f"{value:.4g}") for key, value in values(state).items()})
        budget = predict_terms(build_laboratory(counting(config)))[config.centroid].budget
        short = _aimed(budget) / cheap
    return Tuned(config=config, budget=budget, evaluations=count, cost=float(solved.cost))


def differences(config: Config, base: Config | None = None) -> dict[str, tuple[Any, Any]]:
    """Dotted keys in which a configuration differs from another (the defaults): value there, value here."""

    def walk(a: Mapping[str, Any], b: Mapping[str, Any], prefix: str) -> dict[str, tuple[Any, Any]]:
        found: dict[str, tuple[Any, Any]] = {}
        for key, value in b.items():
            if isinstance(value, Mapping):
                found |= walk(a[key], value, f"{prefix}{key}.")
            elif a[key] != value:
                found[prefix + key] = (a[key], value)
        return found

    return walk((base or Config()).model_dump(), config.model_dump(), "")


def as_toml(config: Config, heading: Sequence[str]) -> str:
    """The differences from the defaults as TOML."""
    lines = [f"# {line}" for line in heading]
    tables: dict[str, list[str]] = {"": []}
    for key, (_, value) in differences(config).items():
        table, _, name = key.rpartition(".")
        text = (
            f'"{value}"' if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)
        )
        tables.setdefault(table, []).append(f"{name} = {text}")
    for table, rows in tables.items():
        lines += ["", *([f"[{table}]"] if table else []), *rows] if rows else []
    return "\n".join(lines) + "\n"


@click.command(help=(__doc__ or "").partition("\n\n")[0])
@click.option("--config", "file", metavar="FILE", help="Where to begin: TOML file or name of a shipped configuration.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="One setting, dotted keys; repeatable.")
@click.option("--prnu", is_flag=True, help="Free the response non-uniformity too.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="TOML file to write.")
def _command(file: str | None, settings: tuple[str, ...], prnu: bool, out: Path) -> None:
    from render.engine import Engine

    start = load_config(Config, file=configuration_file(file), settings=settings)
    Engine.start("auto")

    found = tune(start, prnu=prnu, report=lambda line: click.echo(line, err=True))
    heading = [
        "Tuned by python -m experiments.budget.tune: predicted against published [arcsec, 3 sigma, x and y]",
        *(
            f"{name}: {found.budget[name].arcsec[0]:.2f} {found.budget[name].arcsec[1]:.2f}, "
            f"published {pair[0]:.2f} {pair[1]:.2f}"
            for name, pair in _WANTED.items()
        ),
    ]
    out.write_text(as_toml(found.config, heading), encoding="utf-8")
    click.echo(f"{found.evaluations} predictions; written: {out}")


if __name__ == "__main__":
    sys.exit(invoke(_command, None, prog="python -m experiments.budget.tune", alone=True))
