"""``python -m experiments.skycal``."""

import sys

from experiments.skycal.experiment import main

if __name__ == "__main__":
    sys.exit(main())
