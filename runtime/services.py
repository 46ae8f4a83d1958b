"""Who takes part on the buses: one row each, in a table that deployment and command ask.

A row loads nothing: what runs a service is named by its module. A service of one's own adds its
row, ``SERVICES["logger"] = Service(...)``, when its package is imported.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

BUSES: Final = ("field", "management", "adversary")

PLANT_FIELD: Final = "tcp/127.0.0.1:7461"
CONTROLLER_FIELD: Final = "tcp/127.0.0.1:7462"
PLANT_MANAGEMENT: Final = "tcp/127.0.0.1:7463"
CONTROLLER_MANAGEMENT: Final = "tcp/127.0.0.1:7464"
TAP_ADVERSARY: Final = "tcp/127.0.0.1:7465"


END_STOP_S: Final = 30.0
"""Seconds that an end of the loop has to stop: 20 for the keys that are being made, the rest for
its last messages, its buses and its files."""


class Ends(NamedTuple):
    """Where a service listens and connects on one bus when no option says otherwise.

    Peers do not relay, so each partner is named.
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


@dataclass(frozen=True)
class Service:
    """One service, or a person's program, as the rest of the system knows it.

    Parameters
    ----------
    name : str
        Its command, its folder in a run, and the common name in its certificate.
    summary : str
        A line for the help.
    package : str
        What ``python -m`` runs; empty for a person's program, which nobody supervises. Its module
        ``command`` has ``add_arguments(parser)`` and ``run(args)``.
    ends : mapping of str to Ends
        The buses that it takes part on. On these it may subscribe to everything.
    publishes : mapping of str to tuple of str
        By bus, the topics on which it may publish, and nobody else.
    reports : bool
        Whether it writes a ``status.json`` into its folder: a table with its time ``t_ns``, and
        how it is in ``health``, which begins with ``ok`` or ``bad``.
    stop_s : float
        Seconds that it has to stop by itself.
    """

    name: str
    summary: str = ""
    package: str = ""
    ends: Mapping[str, Ends] = field(default_factory=dict)
    publishes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    reports: bool = False
    stop_s: float = 5.0

    @property
    def command(self) -> str:
        """The module with ``add_arguments(parser)`` and ``run(args)``; empty without a package."""
        return self.package and f"{self.package}.command"


_ROWS: Final = (
    Service(
        name="controller",
        summary="run the controller service",
        package="controller_service",
        ends={
            "field": Ends((CONTROLLER_FIELD,), (PLANT_FIELD,)),
            "management": Ends((CONTROLLER_MANAGEMENT,), (PLANT_MANAGEMENT,)),
        },
        publishes={
            "field": ("offer",),
            "management": (
                "management/controller/hello",
                "management/controller/status",
                "management/reply/send",
            ),
        },
        reports=True,
        stop_s=END_STOP_S,
    ),
    Service(
        name="plant",
        summary="run the plant service with its simulation",
        package="plant_service",
        ends={"field": Ends((PLANT_FIELD,)), "management": Ends((PLANT_MANAGEMENT,))},
        publishes={
            "field": ("measurement",),
            "management": (
                "management/plant/hello",
                "management/plant/model",
                "management/plant/status",
            ),
        },
        reports=True,
        stop_s=END_STOP_S,
    ),
    Service(
        name="tap",
        summary="run the tap service with its eavesdroppers",
        package="tap_service",
        ends={
            "field": Ends((), (PLANT_FIELD, CONTROLLER_FIELD)),
            "adversary": Ends((TAP_ADVERSARY,)),
        },
        publishes={"adversary": ("adversary/tap/status",)},
        reports=True,
        stop_s=25.0,  # heavy eavesdroppers think to the end of what they heard
    ),
    Service(
        name="dashboard",
        ends={
            "management": Ends((), (PLANT_MANAGEMENT, CONTROLLER_MANAGEMENT)),
            "adversary": Ends((), (TAP_ADVERSARY,)),
        },
    ),
    Service(
        name="operator",
        ends={"management": Ends((), (CONTROLLER_MANAGEMENT,))},
        publishes={"management": ("management/command/send", "management/command/stop-keys")},
    ),
)

SERVICES: Final = {row.name: row for row in _ROWS}
"""Every row, by name."""


def on_bus(bus: str) -> list[Service]:
    """Those who take part on a bus."""
    return [row for row in SERVICES.values() if bus in row.ends]
