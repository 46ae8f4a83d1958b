"""Messages that nobody should send: ``python -m tests.campaigns.fuzz --count 1000000``.

Structured and raw, small and up to 16 MB, to both ends of a link. Nothing may raise, no memory may
stay, and the loop goes on as if nothing had come.
"""

import argparse
import json
import logging
import random
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from protocol.link.events import Event
from protocol.link.session import CountedTransition
from protocol.messages import ControllerHello, Measurement, Message, Offer, PlantHello, SendCommand
from runtime.files import write_atomically
from runtime.inbox import Inbox
from runtime.logs import logger
from tests.campaigns.loop import rules_of
from tests.support.mail import Mail
from tests.support.two_ends import LineEnds, Name
from wyner.sweeps.code import code_version

NUMBERS = (0, -1, 1, 2**63, -(2**63), 10**400, 1e308, -1e308, 5e-324, 0.1, True, None, "", "NaN")
TEXTS = ("", "x" * 5000, "\x1b[31m", "\u202e", "0" * 16, "../../etc")
LARGEST_BYTES = 2**24


def payloads(seed: int, heard: list[bytes]) -> Iterator[bytes]:
    """For ever: messages that were heard, changed; and bytes that are none."""
    draw = random.Random(seed)
    while True:
        kind = draw.random()
        if kind < 0.1 or not heard:
            yield draw.randbytes(draw.choice((0, 1, 7, 100, 2000)))
        elif kind < 0.2:
            contribution = bytearray(draw.choice(heard))
            for _ in range(draw.randint(1, 4)):
                contribution[draw.randrange(len(contribution))] = draw.randrange(256)
            yield bytes(contribution)
        elif kind < 0.3:
            contribution = bytearray(draw.choice(heard))
            yield bytes(contribution[: draw.randrange(len(contribution) + 1)])
        elif kind < 0.3001:
            yield b"[" * draw.choice((1000, LARGEST_BYTES))
        else:
            yield _altered(draw, json.loads(draw.choice(heard)))


def _altered(draw: random.Random, message: dict[str, object]) -> bytes:
    field = draw.choice(list(message))
    what = draw.randrange(5)
    if what == 0:
        del message[field]
    elif what == 1:
        message[field] = draw.choice(NUMBERS)
    elif what == 2:
        message[field] = draw.choice(TEXTS)
    elif what == 3:
        value = [draw.choice(NUMBERS) for _ in range(draw.choice((0, 1, 2, 300)))]
        message[field] = draw.choice((value, [value], [value] * 2))
    else:
        message[draw.choice(TEXTS)] = message[field]
    return json.dumps(message).encode()


def megabytes() -> float:
    """The most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


HEARS: dict[Name, tuple[type[Message], ...]] = {
    "controller": (Measurement, PlantHello, SendCommand),
    "plant": (Offer, ControllerHello),
}


class Fuzzed(LineEnds):
    """A link under way; ``heard`` is what its ends have said, and a command."""

    def __init__(self) -> None:
        self.heard = [SendCommand(id="a", payload=b"x" * 9).wire()]
        self._carried = self._offers = 0
        super().__init__(rules_of("switched", keys=False), 0.1, (b"a",))
        self.run(lambda: self.controller.record.transitions >= 2)

    def said(self, side: Name, message: Mail) -> None:
        """Note it, and send it."""
        self.heard.append(message.payload)
        super().said(side, message)

    def hear(self, side: Name, message: Mail) -> None:
        """An offer has another coin than the one before."""
        if message.kind is Offer:
            self._offers += 1
            self.line.coin, self.line.d = self._offers % 2, 0.3
        super().hear(side, message)

    def traced(self, side: Name, event: Event) -> None:
        """Count message symbols that came through."""
        if side == "plant" and isinstance(event, CountedTransition):
            self._carried += event.role == "message"

    def goes_on(self) -> bool:
        """Whether a message symbol comes through once nothing is lost."""
        carried = self._carried
        self.well(0)
        for _ in range(1000):
            self.step()
            if self._carried > carried:
                return True
        return False


def fuzz(side: Name, count: int, seed: int, until: float = float("inf")) -> int:
    """Send ``count`` messages to one end of a link that runs; how many were sent.

    Every 5000 messages the rest of the link is let on, and must deliver.

    Raises
    ------
    AssertionError
        When the link does not go on.
    """
    draw = random.Random(seed + 1)
    inbox: Inbox[tuple[type[Message], bytes]] = Inbox()
    ends = Fuzzed()
    heard = ends.heard[:]
    for number, payload in enumerate(payloads(seed, heard), start=1):
        kind = draw.choice(HEARS[side])
        inbox.put((kind, payload), len(payload))
        over = number >= count or time.monotonic() > until
        if len(inbox) == 50 or over:
            while inbox:
                ends.now += 1e-5
                ends.hear(side, Mail(*inbox.get(0.0)))
        if number % 5000 == 0 or over:
            assert ends.goes_on(), f"after {number} messages the link does not go on"
            ends = Fuzzed()
            heard[:] = ends.heard
        if over:
            break
    return number


class _Lines(logging.Handler):
    """Counts what a service logs, in place of its log."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        """One line more."""
        self.count += 1


def main(argv: list[str] | None = None) -> int:
    """Fuzz both ends; the memory must stay where it was."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="messages to each end")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="for each end")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--who", default=",".join(HEARS), help="of these")
    parser.add_argument("--results", type=Path, default=Path("campaign-fuzz.json"))
    args = parser.parse_args(argv)
    told: dict[str, object] = {"version": code_version("tests.campaigns.fuzz", without=())}
    for who in args.who.split(","):
        before, until = megabytes(), time.monotonic() + args.seconds
        began, lines = time.monotonic(), _Lines()
        logger(who).handlers[:] = [lines]
        count = fuzz(who, args.count, args.seed, until)
        told[who] = {
            "messages": count,
            "grown_mb": round(megabytes() - before, 1),
            "seconds": round(time.monotonic() - began),
            "log_lines": lines.count,
        }
        print(f"{who}: {told[who]}", file=sys.stderr)
    write_atomically(args.results, json.dumps(told, indent=1).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
