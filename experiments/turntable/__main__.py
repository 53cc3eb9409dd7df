"""``python -m experiments.turntable``."""

import sys

from experiments.turntable.settings import main

if __name__ == "__main__":
    sys.exit(main())
