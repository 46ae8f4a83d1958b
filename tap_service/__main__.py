"""``python -m tap_service``: ``wyner tap`` for one who has no scenario, with ``--knowledge``."""

import sys

from runtime.command import serve

if __name__ == "__main__":
    sys.exit(serve("tap"))
