"""``python -m experiments.reduce``."""

import sys

from experiments.reduce.command import main

if __name__ == "__main__":
    sys.exit(main())
