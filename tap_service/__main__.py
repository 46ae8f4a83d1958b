"""``python -m tap_service``: the same as ``wyner tap``."""

import sys

from wyner.__main__ import main

if __name__ == "__main__":
    sys.exit(main("tap"))
