"""``python -m plant_service``: the same as ``wyner plant``."""

import sys

from wyner.__main__ import main

if __name__ == "__main__":
    sys.exit(main("plant"))
