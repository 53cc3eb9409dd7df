"""``python -m experiments.cube``."""

import sys

from experiments.cube.settings import main

if __name__ == "__main__":
    sys.exit(main())
