"""Who may publish what: Zenoh access control for a router, by the names in certificates.

Everything is denied that is not allowed by name. Each message type has one publisher; the readers
of a bus may subscribe to its keys and publish nothing.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final

from protocol.messages import (
    FIELD,
    INTEL,
    OPS,
    ControllerHello,
    ControllerStatus,
    Measurement,
    Message,
    Offer,
    PlantHello,
    PlantStatus,
    SendCommand,
    SendReply,
    TapStatus,
)
from protocol.topics import BASE, VERSION

TYPES: Final[dict[str, tuple[type[Message], ...]]] = {"field": FIELD, "ops": OPS, "intel": INTEL}

PUBLISHER: Final[dict[type[Message], str]] = {
    Measurement: "plant",
    Offer: "controller",
    PlantHello: "plant",
    ControllerHello: "controller",
    SendCommand: "operator",
    SendReply: "controller",
    PlantStatus: "plant",
    ControllerStatus: "controller",
    TapStatus: "tap",
}
"""Common name of the certificate that may publish each type, and no other may."""

READERS: Final[dict[str, tuple[str, ...]]] = {
    "field": ("controller", "plant", "tap"),
    "ops": ("controller", "plant", "dashboard", "operator"),
    "intel": ("tap", "dashboard"),
}
"""Common names that may subscribe on each bus."""


def key_of_any_loop(message_type: type[Message]) -> str:
    """The keys on which a type travels, whatever the loop."""
    return f"{BASE}/{VERSION}/*/{message_type.topic}"


def access_control(bus: str) -> dict[str, Any]:
    """Zenoh's table ``access_control`` for a router that carries one bus.

    Parameters
    ----------
    bus : str
        ``field``, ``ops`` or ``intel``.
    """
    keys = [key_of_any_loop(message_type) for message_type in TYPES[bus]]
    rules: list[dict[str, Any]] = [
        # Ingress is what comes from the partner, egress what the router passes on to him.
        _rule("subscribe", ["ingress"], ["declare_subscriber"], keys),
        _rule("deliver", ["egress"], ["put", "declare_subscriber"], keys),
    ]
    policies = []
    for name in READERS[bus]:
        own = [t for t in TYPES[bus] if PUBLISHER[t] == name]
        granted = ["subscribe", "deliver"]
        if own:
            rules.append(_rule(f"publish-{name}", ["ingress"], ["put"], map(key_of_any_loop, own)))
            granted.append(f"publish-{name}")
        policies.append({"subjects": [name], "rules": granted})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in READERS[bus]],
        "policies": policies,
    }


def _rule(
    name: str, flows: Sequence[str], messages: Sequence[str], keys: Iterable[str]
) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows),
        "messages": list(messages),
        "key_exprs": list(keys),
    }
