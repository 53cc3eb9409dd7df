"""``python -m experiments.twin``."""

import sys

from experiments.twin.settings import main

if __name__ == "__main__":
    sys.exit(main())
