"""Who may publish what: Zenoh access control for a router, by the names in certificates.

Everything is denied that is not allowed by name. Each message type has one publisher; the readers
of a bus may subscribe to its keys and publish nothing.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from protocol.topics import BASE, VERSION
from runtime.services import on_bus


def keys_of_any_loop(topics: Iterable[str]) -> list[str]:
    """The keys on which topics travel, whatever the loop."""
    return [f"{BASE}/{VERSION}/*/{topic}" for topic in topics]


def access_control(bus: str) -> dict[str, Any]:
    """Zenoh's table ``access_control`` for a router that carries one bus.

    Parameters
    ----------
    bus : str
        ``field``, ``management`` or ``adversary``.
    """
    there = on_bus(bus)
    keys = keys_of_any_loop(topic for row in there for topic in row.publishes.get(bus, ()))
    rules: list[dict[str, Any]] = [
        # Ingress is what comes from the partner, egress what the router passes on to him.
        _rule("subscribe", ["ingress"], ["declare_subscriber"], keys),
        _rule("deliver", ["egress"], ["put", "declare_subscriber"], keys),
    ]
    policies = []
    for row in there:
        granted = ["subscribe", "deliver"]
        own = keys_of_any_loop(row.publishes.get(bus, ()))
        if own:
            rules.append(_rule(f"publish-{row.name}", ["ingress"], ["put"], own))
            granted.append(f"publish-{row.name}")
        policies.append({"subjects": [row.name], "rules": granted})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": row.name, "cert_common_names": [row.name]} for row in there],
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
