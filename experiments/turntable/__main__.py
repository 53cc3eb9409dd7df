"""``python -m experiments.turntable``."""

import sys

from experiments.turntable.experiment import main

if __name__ == "__main__":
    sys.exit(main())
