"""Who takes part on the buses: one row each, in a table that deployment and command ask.

A row loads nothing: what runs a service is named by its module. A service of one's own adds its
row, ``SERVICES["logger"] = Service(...)``, when its package is imported.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from runtime.health import Look, look_at_capture, look_at_status

BUSES: Final = ("field", "management", "adversary")

FORMER: Final = {"ops": "management", "intel": "adversary"}
"""What buses were called up to key expressions of version 1."""

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


class Health(Protocol):
    """Looks at what a service writes below its folder; raises Failure where nothing is."""

    def __call__(self, folder: Path, now_s: float) -> Look: ...  # noqa: D102


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
    health : Health, optional
        How to see whether it advances.
    stop_s : float
        Seconds that it has to stop by itself.
    """

    name: str
    summary: str = ""
    package: str = ""
    ends: Mapping[str, Ends] = field(default_factory=dict)
    publishes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    health: Health | None = None
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
        health=look_at_status,
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
        health=look_at_status,
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
        health=look_at_capture,
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


def bus_names(got: str, allowed: Iterable[str]) -> str:
    """The names that are expected, and what a former name was changed to.

    Examples
    --------
    >>> bus_names("ops", ["field", "management"])
    'field, management; ops is called management now'
    """
    expected = ", ".join(allowed)
    return f"{expected}; {got} is called {FORMER[got]} now" if got in FORMER else expected


def on_bus(bus: str) -> list[Service]:
    """Those who take part on a bus."""
    return [row for row in SERVICES.values() if bus in row.ends]
