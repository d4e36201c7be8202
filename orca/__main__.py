"""``python -m orca``."""

import sys

from orca.cli import main

if __name__ == "__main__":
    sys.exit(main())
