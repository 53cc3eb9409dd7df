"""``python -m experiments.skycal``."""

import sys

from experiments.skycal.settings import main

if __name__ == "__main__":
    sys.exit(main())
