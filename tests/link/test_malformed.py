"""Messages that nobody should send: nothing raises, and the link goes on as if none had come."""

import json
from collections.abc import Callable
from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st

from protocol.link.events import Event
from protocol.link.session import CountedTransition
from protocol.messages import ControllerHello, Measurement, Message, Offer, PlantHello, SendCommand
from tests.campaigns.loop import rules_of
from tests.support.mail import Mail
from tests.support.pair import LinePair, Name

HEARS: dict[Name, tuple[type[Message], ...]] = {
    "controller": (Measurement, PlantHello, SendCommand),
    "plant": (Offer, ControllerHello),
}

AGAIN = 1000
"""Steps within which a message symbol must come through once nothing is wrong."""

odd = st.one_of(
    st.sampled_from(
        [0, -1, 1, 2**63, -(2**63), 10**400, 1e308, 5e-324, 0.1, True, None, "", "NaN"]
    ),
    st.sampled_from(["x" * 5000, "\x1b[31m", "\u202e", "0" * 16, "../../etc"]),
    st.lists(st.floats(allow_nan=False), max_size=300),
    st.lists(st.lists(st.just(10**400), max_size=2), max_size=3),
)


Alter = Callable[[dict[str, Any], str, object], bytes]


def deleted(fields: dict[str, Any], name: str, _value: object) -> bytes:
    return json.dumps({n: v for n, v in fields.items() if n != name}).encode()


def replaced(fields: dict[str, Any], name: str, value: object) -> bytes:
    return json.dumps(fields | {name: value}).encode()


def added(fields: dict[str, Any], _name: str, value: object) -> bytes:
    return json.dumps(fields | {str(value)[:9]: value}).encode()


class UnderWay(LinePair):
    """A link under way; ``said_of`` has the newest message of each kind."""

    def __init__(self) -> None:
        self.said_of: dict[type, bytes] = {
            SendCommand: SendCommand(id="a", payload=b"x" * 9).wire()
        }
        self.carried = self._offers = 0
        super().__init__(rules_of("switched", keys=False), 0.1, (b"a",))
        self.run(lambda: self.controller.state.record.link.transitions >= 2)

    def said(self, side: Name, message: Mail) -> None:
        """Note it, and send it."""
        self.said_of[message.kind] = message.payload
        super().said(side, message)

    def hear(self, side: Name, message: Mail) -> None:
        """An offer has another coin than the one before."""
        if message.kind is Offer:
            self._offers += 1
            self.line.coin, self.line.d = self._offers % 2, 0.3
        super().hear(side, message)

    def traced(self, side: Name, event: Event) -> None:
        """Count message symbols that came through; a spoiled one that fits may break a frame."""
        if side == "plant" and isinstance(event, CountedTransition):
            self.carried += event.role == "message"

    def goes_on(self) -> bool:
        """Whether a message symbol comes through once nothing is lost."""
        before = self.carried
        self.well(0)
        for _ in range(AGAIN):
            self.next()
            if self.carried > before:
                return True
        return False


@st.composite
def spoiled(draw: st.DrawFn) -> tuple[Name, type[Message], Any]:
    """Who hears it, as what, and what becomes of the bytes of an honest message."""
    side: Name = draw(st.sampled_from(sorted(HEARS)))
    kind = draw(st.sampled_from(HEARS[side]))
    how: Alter = draw(st.sampled_from((deleted, replaced, added)))
    place, value = draw(st.integers(0, 63)), draw(odd)

    def in_a_field(honest: bytes) -> bytes:
        fields: dict[str, Any] = json.loads(honest)
        return how(fields, sorted(fields)[place % len(fields)], value)

    def cut(honest: bytes) -> bytes:
        return honest[: len(honest) * place // 64]

    def flipped(honest: bytes) -> bytes:
        at = len(honest) * place // 64
        return honest[:at] + bytes([honest[at] ^ (1 + place)]) + honest[at + 1 :]

    noise = draw(st.binary(max_size=200))
    return side, kind, draw(st.sampled_from((in_a_field, cut, flipped, lambda _honest: noise)))


NESTED = 1 << 20


@given(st.lists(spoiled(), min_size=1, max_size=20))
@example([(side, kind, lambda _honest: b"[" * NESTED) for side in HEARS for kind in HEARS[side]])
@settings(deadline=None)
def test_what_is_no_message_changes_nothing(them: list[tuple[Name, type[Message], Any]]) -> None:
    ends = UnderWay()
    for side, kind, spoil in them:
        ends.now += 1e-5
        honest = ends.said_of.get(kind, ends.said_of[SendCommand])
        ends.hear(side, Mail(kind, spoil(honest)))
    assert ends.goes_on()
