"""``python -m experiments.temporal``."""

import sys

from experiments.temporal.experiment import main

if __name__ == "__main__":
    sys.exit(main())
