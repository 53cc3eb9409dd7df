"""One thread for linear algebra: the matrices are small, and idle threads of OpenBLAS spin. No progress on stderr."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is first imported, after this file
os.environ.setdefault("STARBENCH_PROGRESS", "none")  # what commands write there is compared as a whole
