"""``python -m controller_service``: the same as ``wyner controller``."""

import sys

from wyner.cli import main

if __name__ == "__main__":
    sys.exit(main(["controller", *sys.argv[1:]]))
