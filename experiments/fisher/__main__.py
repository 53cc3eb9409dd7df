"""``python -m experiments.fisher``."""

import sys

from experiments.fisher.settings import main

if __name__ == "__main__":
    sys.exit(main())
