"""Flight: attitude error of frames rendered along an orbit, compared with the error budget.

A star sensor flies along an orbit: its attitude law, its temperatures, aberration and stray light. Segments of the
orbit are rendered frame by frame, and a star tracker makes attitudes of them, from lost in space to tracking. Their
errors are split into the terms of ECSS-E-ST-60-20C, each beside a prediction that uses no frames.
"""
