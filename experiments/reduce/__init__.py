"""Reduction of a laboratory's own frames by the methods of the experiments, with consistency checks.

A folder holds FITS frames and ``frames.toml`` (docs/frames.md). `folder` reads it and cuts windows around the points,
`series` centroids them, `checks` judges the frames, `pipeline` runs the sequence. The sections of a method are in
``own_frames.py`` of the experiment of that name.
"""
