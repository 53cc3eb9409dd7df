"""``python -m experiments.cube``."""

import sys

from experiments.cube.experiment import main

if __name__ == "__main__":
    sys.exit(main())
