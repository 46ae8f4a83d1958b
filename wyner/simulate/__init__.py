"""The closed loop without a network: one process, and many runs at once."""

from typing import Final

UNATTACKED: Final = "attack: expected none, as these loops are honest (wyner up attacks one)"
"""Over a scenario whose attack would be left out."""
