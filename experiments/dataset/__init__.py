"""Datasets: thousands of frames of the real sky with exact truth.

Every frame is the real sky through a traced lens, read out with noise, with a table of the true position of each star.
Frame k has the same bytes for any order of frames and number of workers. Finished frames are kept: the same command
continues after an interrupt, a killed machine or a full disk, and extends the dataset to more frames.

One frame: ``plan`` (attitude, motion; ``splits``), ``scene`` (camera, stars, light of the sky), ``frame``, ``truth``,
``labels``, ``truth_files``. Many frames: ``job``, ``workers``, ``folder``, ``remote``. Description and exports:
``card``, ``exports``, ``calibration``. Evaluation: ``detection``, ``solve``. Sequence of all: ``experiment``.
"""
