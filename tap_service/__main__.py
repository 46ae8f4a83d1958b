"""``python -m tap_service``: the same as ``wyner tap``."""

import sys

from protocol.runtime.command import serve

if __name__ == "__main__":
    sys.exit(serve("tap"))
