"""How Zenoh is configured, with the reason for each setting.

Congestion control is DROP, set on each publisher: BLOCK held a put for 5.0 s. Low latency transport
stays off: with it a frozen third party stalls the loop.
"""

from typing import Any, Final

from runtime.addresses import Addresses

LEASE_MS: Final = 2000
"""A partner silent for so long counts as gone: the loop freezes no longer than this. After a longer
lease stale messages come in a burst."""

CONNECT_ATTEMPT_MS: Final = 500
"""Length of one attempt of a client to open; between attempts a signal can end the wait."""

OPEN_MS: Final = 1000
"""Longest attempt to reach a partner. A session that is closed waits for the one under way, and a
stopped container's address answers nothing."""

ONE_THREAD: Final = (
    "(acc: (handover: rx), net: (handover: rx), tx: (handover: rx), rx: (worker_threads: 1))"
)
"""Zenoh's setting by which accepting, sending and keeping alive are done where it receives: one
thread of its own instead of four, and 1.25 times as many steps in lock-step."""


JOIN_MS: Final = 250
"""Between two greetings to a multicast group. Who has not heard a sender's greeting hears nothing
of it, and greetings get lost like everything else."""


def settings_of(endpoints: Addresses) -> dict[str, Any]:
    """What a session with these endpoints is told, key to JSON value."""
    client, tls = endpoints.client, endpoints.tls
    settings: dict[str, Any] = {
        "mode": "client" if client else "peer",
        "connect/endpoints": list(endpoints.connect),
        # A peer tries for ever in the background. With a time-out of 0 it would try once.
        "connect/timeout_ms": CONNECT_ATTEMPT_MS if client else -1,
        "connect/exit_on_failure": client,
        "connect/retry": {
            "period_init_ms": 50,
            "period_max_ms": 500,
            "period_increase_factor": 2,
        },
        # Without this a peer listens on every address of the machine.
        "listen/endpoints": list(endpoints.listen),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "scouting/delay": 0,
        "scouting/multicast/enabled": False,
        # Gossip goes round a router's access control.
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
        "transport/link/tx/lease": LEASE_MS,
        # What a peer or a router puts together of fragments; larger messages are lost there.
        "transport/link/rx/max_message_size": 2**24,
        # Express messages fill a batch each; the usual 2 batches dropped 0.45 % of bursts of 200.
        "transport/link/tx/queue/size/data": 16,
        # Messages over 3 kB, statuses among them, would go through 16 MiB of it in each process.
        "transport/shared_memory/enabled": False,
        "transport/multicast/join_interval": JOIN_MS,
        "transport/unicast/open_timeout": OPEN_MS,
        "transport/unicast/accept_timeout": 2000,
    }
    if tls is not None:
        settings["transport/link/protocols"] = ["tls"]
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(tls.ca),
            "enable_mtls": True,
            "listen_certificate": str(tls.certificate),
            "listen_private_key": str(tls.key),
            "connect_certificate": str(tls.certificate),
            "connect_private_key": str(tls.key),
        }
    return settings
