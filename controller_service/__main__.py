"""``python -m controller_service``: the same as ``wyner controller``."""

import sys

from runtime.command import serve

if __name__ == "__main__":
    sys.exit(serve("controller"))
