"""``python -m experiments.acf``."""

import sys

from experiments.acf.settings import main

if __name__ == "__main__":
    sys.exit(main())
