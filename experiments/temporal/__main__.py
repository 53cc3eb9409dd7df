"""``python -m experiments.temporal``."""

import sys

from experiments.temporal.settings import main

if __name__ == "__main__":
    sys.exit(main())
