"""An end as bytes, the same for the same state, to be gone on from more than once."""

import copyreg
import io
import pickle
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from controller_service.state import ControllerState
from controller_service.telemetry import ControllerTelemetry
from plant_service.core import PlantCore
from plant_service.state import PlantState
from plant_service.status import PlantTelemetry
from protocol.link.session import Rules
from protocol.messages import FIELD, MANAGEMENT, Message
from protocol.secret.blocks import Schedule
from runtime.journal import ControllerJournal, PlantJournal
from tests.campaigns.end import End
from tests.campaigns.loop import BLOCK, rules_of
from tests.support.journals import contents, controller_journal, fill, plant_journal
from tests.support.line import ActingLine, LineDevice, LinePlant

PASSING: Final = frozenset(
    (
        *("journal", "device", "_shell", "line"),  # shared, kept apart, or a second name
        *(
            "out",
            "news",
            "again",
            "confirmed",
            "answered",
            "things",
            "_nonces",
            "_reports",
            "_heard_k",
        ),  # of one event
    )
)

_whole: Final[dict[str, Any]] = {}
"""The end that is being unpacked and its journal, to which its parts refer."""


_JOURNALS: Final[dict[str, PlantJournal | ControllerJournal]] = {
    "plant": plant_journal(),
    "controller": controller_journal(),
}


def _part(name: str) -> Any:
    return _whole[name]


def _rules(scheme: str, keys: bool, coin: bool) -> Rules:
    return rules_of(scheme, keys=keys, coin=coin)


def _schedule() -> Schedule:
    return BLOCK


@lru_cache(maxsize=100_000)
def _message(kind: type[Message], wire: bytes) -> Message:
    return kind.model_validate_json(wire)


def _rules_of(rules: Rules) -> tuple[Any, ...]:
    return _rules, (rules.scheme.name, rules.schedule is not None, rules.keyed)


def _message_of(message: Message) -> tuple[Any, ...]:
    return _message, (type(message), message.wire())


_SHARED: Final[dict[type, Callable[[Any], Any]]] = {
    **copyreg.dispatch_table,
    End: lambda _: (_part, ("End",)),
    LineDevice: lambda _: (_part, ("device",)),
    ControllerJournal: lambda _: (_part, ("journal",)),
    PlantJournal: lambda _: (_part, ("journal",)),
    **dict.fromkeys((PlantState, ControllerState), lambda _: (_part, ("state",))),
    **dict.fromkeys((PlantTelemetry, ControllerTelemetry), lambda _: (_part, ("news",))),
    Rules: _rules_of,
    Schedule: lambda _: (_schedule, ()),
    **dict.fromkeys((*FIELD, *MANAGEMENT), _message_of),
}
"""How what all states share is written."""


class _Packer(pickle.Pickler):
    """Writes each thing in one way only, and leaves out what is shared by all states."""

    def __init__(self, file: io.BytesIO, protocol: int) -> None:
        super().__init__(file, protocol)
        self.fast = True  # no back references: they would tell one state apart from itself
        self.dispatch_table = _SHARED


def _acted(device: LineDevice | None) -> dict[str, Any] | None:
    """What a device is, but for who looks after deaths; nothing where there is none."""
    if device is None:
        return None
    return {name: value for name, value in vars(device).items() if name != "passes"}


def pack(end: End) -> bytes:
    """The end as bytes."""
    own = {name: value for name, value in vars(end).items() if name not in PASSING}
    file = io.BytesIO()
    state = vars(end.endpoint.state)
    for part in (end.side, contents(end.journal), _acted(end.device), state, own):
        _Packer(file, pickle.HIGHEST_PROTOCOL).dump(part)
    return file.getvalue()


def unpack(packed: bytes) -> End:
    """An end as it was packed; it takes over the journal of the one unpacked before."""
    file = io.BytesIO(packed)
    side, rows, acted = pickle.load(file), pickle.load(file), pickle.load(file)
    end = End.__new__(End)
    end.device = None
    if acted is not None:
        end.device = LineDevice()
        vars(end.device).update(acted)
    _whole.clear()
    end.journal = fill(_JOURNALS[side], rows)
    plant = side == "plant"
    state: Any = object.__new__(PlantState if plant else ControllerState)
    news = PlantTelemetry() if plant else ControllerTelemetry()
    _whole.update(End=end, journal=end.journal, device=end.device, state=state, news=news)
    vars(state).update(pickle.load(file))
    vars(end).update(pickle.load(file))
    end.mortal()
    end.line = None
    if isinstance(end.endpoint, PlantCore):
        assert isinstance(end.endpoint.stepper.plant, LinePlant | ActingLine)
        end.line = end.endpoint.stepper.coin = (
            end.endpoint.stepper.plant
        )  # one thing, written twice
    return end
