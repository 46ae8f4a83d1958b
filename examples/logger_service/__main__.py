"""``python -m logger_service``."""

import sys

from runtime.command import serve

sys.exit(serve("logger"))
