"""The attacker: spoofs the sensor, the actuator or the field bus with what she holds."""

from typing import Final

LACKS: Final = "lacks"
"""What an attack that cannot be made of what it is given is told under."""
