"""``python -m experiments.chromatic``."""

import sys

from experiments.chromatic.experiment import main

if __name__ == "__main__":
    sys.exit(main())
