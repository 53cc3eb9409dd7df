"""``python -m experiments.hsfe``."""

import sys

from experiments.hsfe.settings import main

if __name__ == "__main__":
    sys.exit(main())
