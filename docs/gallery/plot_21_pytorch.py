"""
The dataset in PyTorch
======================

A map-style dataset of the folder: frames as tensors, with star positions. PyTorch (``pip install torch``) is optional:
without it the same lines run on arrays, frame by frame.
"""

from importlib import import_module
from importlib.util import find_spec
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq
from astropy.io import fits

from calib import show_image
from experiments import run_experiment

settings = {"frames": 2, "instrument.width_px": 256, "instrument.height_px": 256}
settings |= {"calibration_frames": 0, "verify.frames": 0}
with TemporaryDirectory() as folder:
    run_experiment("dataset", settings, out=f"{folder}/sky")
    index = pq.read_table(f"{folder}/sky/index.parquet").to_pylist()
    torch = import_module("torch") if find_spec("torch") else None

    class Stars(torch.utils.data.Dataset if torch else object):
        def __len__(self):
            return len(index)

        def __getitem__(self, k):
            dn = fits.getdata(f"{folder}/sky/{index[k]['file']}").astype("float32")
            truth = pq.read_table(f"{folder}/sky/{index[k]['truth']}", columns=["photon_x_px", "photon_y_px"])
            both = dn, truth.to_pandas().to_numpy(copy=True)
            return tuple(map(torch.from_numpy, both)) if torch else both

    loader = torch.utils.data.DataLoader(Stars(), batch_size=None) if torch else map(Stars().__getitem__, (0, 1))
    for frame, places in loader:
        print(type(frame).__name__, tuple(frame.shape), "pixels,", len(places), "stars")
axes = show_image(np.asarray(frame))
axes.scatter(*np.asarray(places).T, s=60, facecolors="none", edgecolors="#59d98e")
