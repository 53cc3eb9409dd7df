"""``python -m experiments.dataset``."""

import sys

from experiments.dataset.settings import main

if __name__ == "__main__":
    sys.exit(main())
