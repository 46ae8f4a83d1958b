"""Who may publish what: Zenoh access control for a router, by the names in certificates.

Everything is denied that is not allowed by name. Each message type has one publisher; the readers
of a bus may subscribe to its keys and publish nothing.
"""

from typing import Any

from protocol.topics import BASE, VERSION
from runtime.services import on_bus


def access_control(bus: str) -> dict[str, Any]:
    """Zenoh's table ``access_control`` for a router that carries one bus.

    Parameters
    ----------
    bus : str
        ``field``, ``management`` or ``adversary``.
    """
    own = {
        row.name: [f"{BASE}/{VERSION}/*/{topic}" for topic in row.publishes.get(bus, ())]
        for row in on_bus(bus)
    }
    every = [key for keys in own.values() for key in keys]
    rules = [
        # Ingress is what comes from the partner, egress what the router passes on to him.
        _rule("subscribe", "ingress", ["declare_subscriber"], every),
        _rule("deliver", "egress", ["put", "declare_subscriber"], every),
    ]
    policies = []
    for name, keys in own.items():
        granted = ["subscribe", "deliver"]
        if keys:
            rules.append(_rule(f"publish-{name}", "ingress", ["put"], keys))
            granted.append(f"publish-{name}")
        policies.append({"subjects": [name], "rules": granted})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in own],
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }
