"""``python -m plant_service``: the same as ``wyner plant``."""

import sys

from wyner.cli import main

if __name__ == "__main__":
    sys.exit(main(["plant", *sys.argv[1:]]))
