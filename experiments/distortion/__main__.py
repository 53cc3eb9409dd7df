"""``python -m experiments.distortion``."""

import sys

from experiments.distortion.experiment import main

if __name__ == "__main__":
    sys.exit(main())
