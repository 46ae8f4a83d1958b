"""The messages on the wire: frozen, versioned. Nothing on the field bus is secret.

Each of the three buses has a file of this package. The tap reads *field* messages. They hold no
key, no plaintext and no automaton state, and have the same form in both states. *Management*
messages pass between controller, plant, dashboard and operator. *Adversary* messages carry the
tap's guesses.

Field messages are flat, so a recorder's schema of each needs no reference. A status is made of
parts, which stand in the file of its bus.
"""

from protocol.messages.adversary import ADVERSARY, TapStatus
from protocol.messages.base import LARGEST_COUNT, SCHEMA, Message
from protocol.messages.field import FIELD, FieldMessage, Measurement, Offer
from protocol.messages.management import (
    LATENCY_BOUNDS_S,
    MANAGEMENT,
    ControllerHello,
    ControllerStatus,
    PlantHello,
    PlantModel,
    PlantStatus,
    SendCommand,
    SendReply,
    Status,
    StopKeys,
)

__all__ = [
    "ADVERSARY",
    "FIELD",
    "LARGEST_COUNT",
    "LATENCY_BOUNDS_S",
    "MANAGEMENT",
    "SCHEMA",
    "ControllerHello",
    "ControllerStatus",
    "FieldMessage",
    "Measurement",
    "Message",
    "Offer",
    "PlantHello",
    "PlantModel",
    "PlantStatus",
    "SendCommand",
    "SendReply",
    "Status",
    "StopKeys",
    "TapStatus",
]
