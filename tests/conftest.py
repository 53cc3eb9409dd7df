"""One thread for linear algebra: the matrices of the tests are small, and idle threads of OpenBLAS spin."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is first imported, after this file
