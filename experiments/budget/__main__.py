"""``python -m experiments.budget``."""

import sys

from experiments.budget.settings import main

if __name__ == "__main__":
    sys.exit(main())
