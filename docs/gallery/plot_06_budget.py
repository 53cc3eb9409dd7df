"""
The error budget of a star camera
=================================

Every term of the budget of the paper ACC18 (3 sigma): predicted without frames for the built-in camera, and as printed
for the paper's camera. ``--config acc18_tuned`` is a camera tuned to the printed budget.
"""

import numpy as np
from matplotlib import pyplot as plt

from experiments import run_experiment
from experiments.laboratory.settings.published import ACC18_ARCSEC

budget = run_experiment("budget", {"predict_only": True})
print(budget.table("budget"))
terms = list(budget.data.term.values[:5])
predicted = budget.data["terms.predicted_arcsec"].sel(term=terms)
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for shift, axis in ((-0.2, "x"), (0.2, "y")):
    axes.bar(np.arange(5) + shift, predicted.sel(axis=axis), 0.36, label=f"predicted, {axis}")
    places = np.arange(5) + shift
    axes.plot(
        places, [ACC18_ARCSEC[term]["xy".index(axis)] for term in terms], "k_", markersize=18, label=f"ACC18, {axis}"
    )
axes.set(ylabel="3 sigma [arcsec]", title="Terms of the budget")
axes.set_xticks(range(5), terms)
axes.legend()
