"""
The scatter of star vectors
===========================

Repeated star vectors scatter on the sphere. The Fisher distribution gives their standard deviation and its confidence
interval; if it applies, the squared distances from the mean are exponentially distributed.
"""

import numpy as np
from matplotlib import pyplot as plt

from calib.directional.fisher import fit_fisher, sample_fisher, tangent_plane

sigma_arcsec, arcsec = 2.0, 206264.806
kappa = (arcsec / sigma_arcsec) ** 2  # concentration of an error of that much per axis
vectors = sample_fisher([0.0, 0.0, 1.0], kappa, 400, np.random.default_rng(7))
fit = fit_fisher(vectors)
low, high = fit.sigma_interval_rad(0.95)
print(f"sigma {arcsec * fit.sigma_rad:.3f} arcsec, 95 % between {arcsec * low:.3f} and {arcsec * high:.3f}; drawn 2")
offset = arcsec * tangent_plane(vectors, fit.mean)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
left.plot(*offset.T, ".", markersize=3)
left.set(xlabel="x [arcsec]", ylabel="y [arcsec]", aspect="equal", title="star vectors about their mean")
square = np.sort((offset**2).sum(axis=1))
expected = -2.0 * (arcsec * fit.sigma_rad) ** 2 * np.log(1.0 - (np.arange(400) + 0.5) / 400)
right.plot(expected, square, ".", markersize=3)
right.plot(expected, expected, color="0.5", linewidth=1)
right.set(xlabel="expected squared distance [arcsec^2]", ylabel="measured", title="exponential?")
