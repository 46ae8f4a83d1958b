"""``python -m plant_service``: the same as ``wyner plant``."""

import sys

from runtime.command import serve

if __name__ == "__main__":
    sys.exit(serve("plant"))
