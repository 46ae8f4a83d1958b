"""The closed loop in one process: many runs at once, or both ends on a simulated network."""

from typing import Final

UNATTACKED: Final = "attack: expected none, as these loops are honest (wyner up attacks one)"
"""Over a scenario whose attack would be left out."""

UNSEALED: Final = (
    "secrecy.scheme: got 'sealed', whose messages travel under distilled keys, and these loops "
    "make none (wyner up --scenario sealed makes them)"
)
"""Over a scenario whose messages would never be sent."""
