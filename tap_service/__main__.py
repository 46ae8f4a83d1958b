"""``python -m tap_service``: the same as ``wyner tap``."""

import sys

from wyner.cli import main

if __name__ == "__main__":
    sys.exit(main(["tap", *sys.argv[1:]]))
