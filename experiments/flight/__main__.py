"""``python -m experiments.flight``."""

import sys

from experiments.flight.settings import main

if __name__ == "__main__":
    sys.exit(main())
