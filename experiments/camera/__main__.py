"""``python -m experiments.camera``."""

import sys

from experiments.camera.settings import main

if __name__ == "__main__":
    sys.exit(main())
