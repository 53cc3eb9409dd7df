"""In flight: does the error budget predict the attitude error of a rendered orbit?

A star sensor flies along an orbit: its attitude law, its temperatures, aberration and stray light. Segments of the
orbit are rendered frame by frame, and a star tracker makes attitudes of them, from lost in space to tracking. Their
errors are split into the terms of ECSS-E-ST-60-20C, each beside a prediction that uses no frames.
"""
