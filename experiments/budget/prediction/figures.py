"""Figures of the predicted budget."""

from __future__ import annotations

from experiments.budget.figures import cause_bars, predicted_bars, sweep_curves

__all__ = ["cause_bars", "predicted_bars", "sweep_curves"]
