"""False-match probability: of as many matches between detections and catalogue stars by chance.

A detection that belongs to no star of the field lies within the radius r of one of m catalogue stars on a detector of
area A with the probability p = m pi r^2 / A, so that n detections have k or more such matches with the probability of a
binomial tail. Two matches fixed the attitude and are no evidence for it; an attitude that is the best of t proposals
had t chances (Bonferroni):

    P = t P(K >= k - 2),     K binomial of n - 2 trials with p.
"""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc


def false_match_probability(
    matches: int, detections: int, proposals: int, *, stars: int, radius_px: float, area_px2: float
) -> float:
    """Probability, at most 1, of as many chance matches with ``stars`` on the detector, for the best of proposals."""
    if matches < 3:
        return 1.0
    single = min(1.0, stars * np.pi * radius_px**2 / area_px2)
    return float(min(1.0, max(proposals, 1) * bdtrc(matches - 3, detections - 2, single)))
