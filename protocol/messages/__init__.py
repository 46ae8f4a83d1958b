"""The messages on the wire: flat, frozen, versioned, and nothing secret on the field bus.

Three buses, three families, a file of this package each. *Field* messages (`Measurement`, `Offer`)
are read by the tap; they hold no key, no plaintext, no automaton state, and look the same in both
automaton states. *Ops* messages pass between controller, plant, dashboard and operator. *Intel*
messages carry the tap's guesses.
Models are flat (no nested model), so that a recorder's schema of each needs no reference.
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
