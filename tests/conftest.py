"""One thread for linear algebra: the matrices are small, and idle threads of OpenBLAS spin. No progress on stderr.

Star patterns are kept in a folder of the tests, not in the user's. Garbage is collected less often: 5 % of the time.
"""

import gc
import os
import tempfile

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is first imported, after this file
os.environ.setdefault("STARBENCH_PROGRESS", "none")  # what commands write there is compared as a whole
os.environ.setdefault("STARBENCH_CACHE", os.path.join(tempfile.gettempdir(), f"starbench-tests-{os.getuid()}"))
gc.set_threshold(20_000, 20, 20)
