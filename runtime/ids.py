"""Random ids."""

import os


def new_id() -> str:
    """A random id of 64 bits, as 16 hexadecimal digits."""
    return os.urandom(8).hex()
