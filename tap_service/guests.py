"""A user's eavesdropper in a process of her own, bounded in time and memory.

She stops herself alone: one that exits, loops for ever, eats memory, forks, closes her streams or
floods what she is asked for is told by a line in her status, and the tap goes on. What she answers
is read as JSON and checked, never unpickled. She runs as the user who started the tap, so she may
read that user's files: this is a bound for mistakes, and no wall against malice.
"""

import base64
import ctypes
import json
import os
import pickle
import resource
import select
import signal
import struct
import subprocess
import sys
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import IO, Any, Final

from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import LADDER, Belief, Eavesdropper, Guess, KnowledgeError, named
from tap_service.eavesdroppers.base import GuestError, KeysHeld

START_S: Final = 20.0
"""Seconds that she has to be loaded and made."""

LIGHT_S: Final = 2.0
"""Seconds that a light one has for an answer: the mirror waits for her."""

HEAVY_S: Final = 15.0
"""Seconds that a heavy one has for an answer."""

MEMORY: Final = 2 * 2**30
"""Bytes of address space that she has."""

ANSWER: Final = 8 * 2**20
"""Bytes of an answer at most."""

_PR_SET_PDEATHSIG: Final = 1
_LENGTH: Final = struct.Struct(">I")


class _Process:
    """Her process: asks it, waits so long, and ends it with all that it started."""

    def __init__(self, name: str) -> None:
        self._child = subprocess.Popen(
            [sys.executable, "-m", "tap_service.guests", name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._to, self._from = self._child.stdin, self._child.stdout
        os.set_blocking(self._to.fileno(), False)
        os.set_blocking(self._from.fileno(), False)
        self.close = weakref.finalize(self, _end, self._child)

    def ask(self, what: str, argument: object, within_s: float) -> Any:
        """Her answer.

        Raises
        ------
        GuestError
            When there is none in time, or it is none; she is then at her end.
        KnowledgeError
            When she says that she lacks knowledge.
        """
        until = time.monotonic() + within_s
        try:
            self._send(pickle.dumps((what, argument)), until)
            answer = json.loads(self._receive(until))
            kind, value = answer["kind"], answer["value"]
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            self.close()
            known = isinstance(error, _Ended | TimeoutError)
            text = str(error) if known else "an answer that is none"
            raise GuestError(text) from None
        if kind == "lacks":
            raise KnowledgeError(str(value))
        if kind == "raised":
            raise GuestError(str(value))
        return value

    def _send(self, body: bytes, until: float) -> None:
        data = memoryview(_LENGTH.pack(len(body)) + body)
        while data:
            _, ready, _ = select.select([], [self._to], [], max(until - time.monotonic(), 0.0))
            if not ready:
                raise TimeoutError("too slow: she does not read")
            data = data[os.write(self._to.fileno(), data) :]

    def _receive(self, until: float) -> bytes:
        (length,) = _LENGTH.unpack(self._read(_LENGTH.size, until))
        if length > ANSWER:
            raise ValueError(f"an answer of {length} bytes")
        return self._read(length, until)

    def _read(self, length: int, until: float) -> bytes:
        parts: list[bytes] = []
        while length:
            ready, _, _ = select.select([self._from], [], [], max(until - time.monotonic(), 0.0))
            if not ready:
                raise TimeoutError("too slow: no answer in time")
            part = os.read(self._from.fileno(), length)
            if not part:
                raise _Ended("her process ended")
            parts.append(part)
            length -= len(part)
        return b"".join(parts)


class _Ended(OSError):
    """The other side of the pipe is gone."""


def _end(child: "subprocess.Popen[bytes]") -> None:
    """Kill a process and its children."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    child.wait()


class Guest(Eavesdropper):
    """A user's eavesdropper as the tap sees her: every question goes to her own process."""

    source = ""

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self._within_s = HEAVY_S if self.heavy else LIGHT_S
        self._process = _Process(self.source)
        try:
            self._process.ask("make", knowledge.model_dump_json(), START_S)
        except BaseException:
            self._process.close()
            raise

    def _ask(self, what: str, argument: object = None) -> Any:
        return self._process.ask(what, argument, self._within_s)

    def observe(self, transition: Transition) -> Guess:
        """Her guess of it; her last thoughts on what she lets go come with it."""
        guess, settled = self._ask("observe", transition)
        self.settled += map(_guess, settled)
        return _guess(guess)

    def hear(self, message: FieldMessage) -> None:
        """Hand her a message."""
        self._ask("hear", message)

    def belief(self) -> Belief:
        """Her best message by now."""
        told = self._ask("belief")
        told["message"] = base64.b64decode(told["message"])
        told["whole"] = tuple(map(base64.b64decode, told["whole"]))
        for name in ("symbols", "A", "B"):
            told[name] = tuple(map(tuple, told[name]))
        told["keys"] = told["keys"] and KeysHeld.model_validate(told["keys"])
        return Belief(**told)

    def review(self) -> Sequence[Guess]:
        """Her second thoughts."""
        return [_guess(guess) for guess in self._ask("review")]


def _guess(told: Any) -> Guess:
    k, symbol, agreed, session = told
    return Guess(int(k), tuple(symbol), agreed, str(session))


@cache
def guarded(name: str) -> type[Eavesdropper]:
    """The class of an eavesdropper; one of the user's own as a :class:`Guest`.

    Raises
    ------
    KnowledgeError
        With one line, when there is no such eavesdropper or she cannot be loaded.
    """
    if name in LADDER or ":" not in name:
        return named(name)
    process = _Process(name)
    try:
        told = process.ask("who", None, START_S)
    except GuestError as error:
        raise KnowledgeError(f"eavesdropper {name}: cannot be loaded: {error}") from None
    finally:
        process.close()
    attributes = {
        "source": name,
        "name": str(told["name"]),
        "heavy": bool(told["heavy"]),
        "told_model": bool(told["told_model"]),
        "hears_messages": bool(told["hears_messages"]),
    }
    return type("Guest", (Guest,), attributes)


# --- her side -------------------------------------------------------------------------------------


def _serve(name: str, to: IO[bytes], out: IO[bytes]) -> None:
    """Answer until the tap is gone."""
    tap: Eavesdropper | None = None
    while (head := to.read(_LENGTH.size)) and len(head) == _LENGTH.size:
        what, argument = pickle.loads(to.read(*_LENGTH.unpack(head)))
        value: object = None
        try:
            if what == "who":
                kind = named(name)
                attributes = ("name", "heavy", "told_model", "hears_messages")
                value = {name: getattr(kind, name) for name in attributes}
            elif what == "make":
                tap = named(name)(Knowledge.model_validate_json(argument))
            else:
                assert tap is not None
                value = _answer(tap, what, argument)
            answer = {"kind": "value", "value": value}
        except KnowledgeError as error:
            answer = {"kind": "lacks", "value": str(error)}
        except Exception as error:
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            answer = {"kind": "raised", "value": text[:2000]}
        body = json.dumps(answer, default=float).encode()
        out.write(_LENGTH.pack(len(body)) + body)
        out.flush()


def _answer(tap: Eavesdropper, what: str, argument: Any) -> object:
    if what == "observe":
        guess = _told(tap.observe(argument))
        settled = [_told(one) for one in getattr(tap, "settled", ())]
        if settled:
            tap.settled.clear()
        return guess, settled
    if what == "review":
        return [_told(one) for one in tap.review()]
    if what == "hear":
        tap.hear(argument)
        return None
    belief = tap.belief()
    if not isinstance(belief, Belief):
        raise TypeError(f"expected a Belief, got {belief!r}")
    return {
        **{name: getattr(belief, name) for name in Belief.__slots__},
        "message": base64.b64encode(belief.message).decode(),
        "whole": [base64.b64encode(bytes(whole)).decode() for whole in belief.whole],
        "keys": None if belief.keys is None else belief.keys.model_dump(),
    }


def _told(guess: object) -> object:
    if not isinstance(guess, Guess):
        raise TypeError(f"expected a Guess, got {guess!r}")
    return [guess.k, [float(p) for p in guess.symbol], float(guess.agreed), guess.session]


def main() -> None:
    """Bound this process, take its pipes away from what she prints, and serve."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError, AttributeError):  # on Linux: end with the tap, however that one ends
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    to, out = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    _serve(sys.argv[1], to, out)


if __name__ == "__main__":
    main()
