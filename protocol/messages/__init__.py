"""The messages on the wire: flat, frozen, versioned. Nothing on the field bus is secret.

Each of the three buses has a file of this package. The tap reads *field* messages. They hold no
key, no plaintext and no automaton state, and have the same form in both states. *Ops* messages pass
between controller, plant, dashboard and operator. *Intel* messages carry the tap's guesses.

No model is nested in another, so a recorder's schema of each needs no reference.
"""

from protocol.messages.base import LARGEST_COUNT, SCHEMA, Message
from protocol.messages.field import FIELD, FieldMessage, Measurement, Offer, Sealed
from protocol.messages.intel import INTEL, TapStatus
from protocol.messages.ops import (
    LATENCY_BOUNDS_S,
    OPS,
    BlockAnnouncement,
    ControllerHello,
    ControllerStatus,
    KeyAnswer,
    KeyRequest,
    PlantHello,
    PlantModel,
    PlantStatus,
    SealCommand,
    SealedReceipt,
    SealReply,
    SendCommand,
    SendReply,
    Status,
)

__all__ = [
    "FIELD",
    "INTEL",
    "LARGEST_COUNT",
    "LATENCY_BOUNDS_S",
    "OPS",
    "SCHEMA",
    "BlockAnnouncement",
    "ControllerHello",
    "ControllerStatus",
    "FieldMessage",
    "KeyAnswer",
    "KeyRequest",
    "Measurement",
    "Message",
    "Offer",
    "PlantHello",
    "PlantModel",
    "PlantStatus",
    "SealCommand",
    "SealReply",
    "Sealed",
    "SealedReceipt",
    "SendCommand",
    "SendReply",
    "Status",
    "TapStatus",
]
