"""Flight: attitude error of frames rendered along an orbit, compared with the error budget.

The inputs are an orbit, an attitude law, temperatures, aberration and stray light. Segments of the orbit are rendered
frame by frame, and a star tracker determines attitudes from them, from lost in space to tracking. Their errors are
split into the terms of ECSS-E-ST-60-20C, each compared with a prediction without frames.
"""
