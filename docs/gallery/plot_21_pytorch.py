"""
The dataset in PyTorch
======================

A map-style dataset over the folder: frames as tensors, star positions beside them. The lines run where PyTorch is
installed (``pip install torch``); it is large, and nothing else here needs it.
"""

from importlib.util import find_spec
from tempfile import TemporaryDirectory

import pyarrow.parquet as pq
from astropy.io import fits

from experiments import run_experiment

settings = {"frames": 2, "instrument.width_px": 256, "instrument.height_px": 256}
settings |= {"calibration_frames": 0, "verify.frames": 0}
with TemporaryDirectory() as folder:
    run_experiment("dataset", settings, out=f"{folder}/sky")
    index = pq.read_table(f"{folder}/sky/index.parquet").to_pylist()
    if find_spec("torch"):
        import torch

        class Stars(torch.utils.data.Dataset):
            def __len__(self):
                return len(index)

            def __getitem__(self, k):
                dn = fits.getdata(f"{folder}/sky/{index[k]['file']}").astype("float32")
                truth = pq.read_table(f"{folder}/sky/{index[k]['truth']}", columns=["photon_x_px", "photon_y_px"])
                return torch.from_numpy(dn), torch.from_numpy(truth.to_pandas().to_numpy())

        for frame, places in torch.utils.data.DataLoader(Stars(), batch_size=None, shuffle=True):
            print(tuple(frame.shape), "pixels,", len(places), "stars")
    else:
        print("PyTorch is not installed:", len(index), "frames are there and were not loaded")
