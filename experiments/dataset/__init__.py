"""Datasets: thousands of frames of the real sky with exact truth.

Every frame is the real sky through a traced lens, read out with noise, beside a table that says where each star truly
is. Frame k is the same bytes whether it is made alone, in any order, or by many workers. What was made stays: run the
same command again after an interrupt, a killed machine or a full disk, and it goes on where it stopped; ask for more
frames, and the dataset grows.

One frame: ``plan`` (attitude, motion; ``splits``), ``scene`` (camera, stars, light of the sky), ``frame``, ``truth``,
``labels``, ``truth_files``. Many frames: ``job``, ``workers``, ``folder``, ``remote``. For others: ``card``,
``exports``, ``calibration``. Looked at as others will: ``detection``, ``solve``. All of it in order: ``experiment``.
"""
