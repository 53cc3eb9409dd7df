"""``python -m experiments.budget``."""

import sys

from experiments.budget.experiment import main

if __name__ == "__main__":
    sys.exit(main())
