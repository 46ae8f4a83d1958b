"""``python -m controller_service``: the same as ``wyner controller``."""

import sys

from wyner.__main__ import main

if __name__ == "__main__":
    sys.exit(main("controller"))
