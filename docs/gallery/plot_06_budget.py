"""
The error budget of a star camera
=================================

Every term of ACC18's budget, predicted without frames, beside what the document prints (3 sigma).
"""

import numpy as np
from matplotlib import pyplot as plt

from experiments import run_experiment

budget = run_experiment("budget", {"predict_only": True, "sweep": ""})
print(budget.table("budget"))
terms = list(budget.data.term.values[:5])
predicted = budget.data.predicted_arcsec.sel(term=terms)
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for shift, axis in ((-0.2, "x"), (0.2, "y")):
    axes.bar(np.arange(5) + shift, predicted.sel(axis=axis), 0.36, label=f"predicted, {axis}")
axes.set(ylabel="3 sigma [arcsec]", title="Terms of the budget")
axes.set_xticks(range(5), terms)
axes.legend()
