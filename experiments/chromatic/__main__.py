"""``python -m experiments.chromatic``."""

import sys

from experiments.chromatic.settings import main

if __name__ == "__main__":
    sys.exit(main())
