"""Reduction of a laboratory's own frames by the methods of the experiments, with consistency checks.

A folder holds FITS frames and ``frames.toml`` (docs/frames.md). `folder` reads it and cuts windows around the points,
`series` centroids them, `checks` judges the frames, `road` makes an experiment of it all. What a method adds, its own
sections, stands in ``own_frames.py`` of the experiment of that name.
"""
