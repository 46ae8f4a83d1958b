"""The closed loop without a network: one process, and many runs at once."""

from typing import Final

UNATTACKED: Final = "attack: expected none, as these loops are honest (wyner up attacks one)"
"""Over a scenario whose attack would be left out."""

UNSEALED: Final = (
    "secrecy.scheme: got 'sealed', whose messages travel under distilled keys, and these loops "
    "make none (wyner up --scenario sealed makes them)"
)
"""Over a scenario whose messages would never be sent."""
