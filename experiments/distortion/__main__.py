"""``python -m experiments.distortion``."""

import sys

from experiments.distortion.settings import main

if __name__ == "__main__":
    sys.exit(main())
