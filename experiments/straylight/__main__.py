"""``python -m experiments.straylight``."""

import sys

from experiments.straylight.settings import main

if __name__ == "__main__":
    sys.exit(main())
