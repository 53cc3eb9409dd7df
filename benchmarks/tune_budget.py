"""Tuning of an instrument by its physical parameters until its predicted budget equals the published one of ACC18.

    python benchmarks/tune_budget.py --set centroid=tcog --set moved.decentre_x_um=5 --set moved.decentre_y_um=90

Solves, by least squares on logarithms, for the signal, the defocus and the decentre of one element: TE follows the
signal, HSFE the focus (how sharp the spot is against the pixel), the chromatic term the decentre. Nothing is rendered
but PSFs. ``experiments/data/acc18_tuned.toml`` is the result. The steps are cheap predictions; after they converge, the
full prediction gives the remaining error of each number, which the next round corrects.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

AIM = ("TE", "HSFE", "LSFE-S", "total")
ROUNDS, STEPS = 2, 3
STATE_STEP = 0.1  # Of the differences: large against the noise of the draws
DEFOCUS_STEP_MM = 0.02  # A change of the defocus that counts as one; half a depth of focus of the lens


def tune(settings: list[str]) -> tuple[dict[str, float], np.ndarray]:
    """Settings of the tuned instrument, and predicted over published (8,): `AIM`, x and y each."""
    from scipy.optimize import least_squares

    from experiments.budget.experiment import PUBLISHED_ARCSEC
    from experiments.budget.laboratory import build_laboratory
    from experiments.budget.predict import coarse_terms, predict_terms
    from experiments.budget.settings import BudgetConfig
    from experiments.harness.config import load_config
    from experiments.harness.range import with_value

    start = load_config(BudgetConfig, settings=[*settings, "compare=[]"])
    signal = build_laboratory(start).signal.signal_e
    start = with_value(with_value(start, "source.magnitude_mag", None), "source.signal_e", signal)
    wanted = np.concatenate([PUBLISHED_ARCSEC[name] for name in AIM])

    def values(state):
        return {
            "source.signal_e": float(signal * np.exp(state[0])),
            "instrument.defocus_mm": float(start.instrument.defocus_mm + DEFOCUS_STEP_MM * state[1]),
            "moved.decentre_y_um": float(start.moved.decentre_y_um * np.exp(state[2])),
            "moved.decentre_x_um": float(start.moved.decentre_x_um * np.exp(state[3])),
        }

    def configured(state):
        config = start
        for key, value in values(state).items():
            config = with_value(config, key, float(f"{value:.4g}"))
        return config

    def aimed(budget):  # A statistic that is zero has no logarithm
        return np.maximum(np.concatenate([budget[name].arcsec for name in AIM]), 1e-3)

    def cheap(state):
        found = aimed(coarse_terms(configured(state)).budget)
        print(" ".join(f"{key}={value:.5g}" for key, value in values(state).items()), found.round(2), flush=True)
        return found

    state, short = np.zeros(4), np.ones(2 * len(AIM))
    for _ in range(ROUNDS):

        def residuals(state, short=short):
            return np.log(cheap(state) * short / wanted)

        def jacobian(state):
            here = residuals(state)
            return np.stack([(residuals(state + s) - here) / STATE_STEP for s in STATE_STEP * np.eye(4)], axis=1)

        limits = {"bounds": (-4.0, 4.0), "xtol": 1e-2, "ftol": 1e-2, "max_nfev": STEPS}
        state = least_squares(residuals, state, jac=jacobian, **limits).x
        config = configured(state)
        full = aimed(predict_terms(build_laboratory(config))[config.centroid].budget)
        short = full / cheap(state)
    return values(state), full / wanted


def main() -> None:
    """Print the tuned settings and what they give."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", dest="settings", action="append", default=[], help="KEY=VALUE of the start")
    found, ratio = tune(parser.parse_args().settings)
    for key, value in found.items():
        print(f"{key} = {value:.4g}")
    for name, pair in zip(AIM, ratio.reshape(-1, 2), strict=True):
        print(f"{name}: predicted over published {pair[0]:.2f} {pair[1]:.2f}")


if __name__ == "__main__":
    main()
