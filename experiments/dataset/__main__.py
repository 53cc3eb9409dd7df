"""``python -m experiments.dataset``."""

import sys

from experiments.dataset.experiment import main

if __name__ == "__main__":
    sys.exit(main())
