"""Counts what a reader must follow: one message byte from ``wyner send`` to the plant's text.

``python -m tools.follow`` starts a plant and a controller over Zenoh on loopback, sends a message
of one byte, and traces every call of the project's own functions in all three processes. Four
*activities* make the byte's way:

1. ``send``: the operator's process, from the moment at which it has the byte.
2. ``queue``: the controller takes the command.
3. ``decide``: the controller's step that offers the byte's last cipher symbol.
4. ``decode``: the plant's step that applies this offer, decodes the symbol and has the text.

A *frame* is a function of the project that is entered in one of them: where a debugger stops. It
*carries* if an argument, or what it returns, is the byte or the offer's symbol, alone or in a
wrapper. A *type* is a class of the project whose instance was such a wrapper.

``--what step`` counts one whole step of the plant instead (``decode`` alone), for any scenario.
"""

import argparse
import base64
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from math import inf
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Final, NamedTuple, TextIO

from runtime.addresses import free_endpoints

ROOT: Final = Path(__file__).resolve().parents[1]

BYTE: Final = "Q"
"""The message: a byte that stands in no option and in no file name."""

SYMBOL_NAMES: Final = ("cipher", "message_symbol")
"""An object with one of these as a field holds a cipher symbol."""

DEPTH: Final = 4
"""Wrappers within wrappers that are looked into."""

LOOP_S: Final = 0.4
"""A call that lasts longer than this is a service's loop: its steps are the calls within."""

START_S: Final = 240.0
"""Seconds until the services have met and the message is delivered, at most."""


# --- inside the traced process -------------------------------------------------------------------


class Recorder:
    """Writes a line for each call and return of the project's functions, with what they carry.

    Parameters
    ----------
    out : text file
    """

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._names: dict[CodeType, str] = {}
        self._lock = threading.Lock()
        self._frame: tuple[bytes, ...] = ()

    def start(self) -> None:
        """Trace this thread, and each one that starts from now on."""
        threading.setprofile(self._event)
        sys.setprofile(self._event)

    def _name(self, code: CodeType) -> str:
        name = self._names.get(code)
        if name is None:
            path = Path(code.co_filename)
            inside = path.is_relative_to(ROOT) and ".venv" not in path.parts
            name = ""
            if inside and path.name != "follow.py" and not code.co_name.startswith("<"):
                module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                name = f"{module}:{code.co_qualname}"
            self._names[code] = name
        return name

    def _event(self, frame: FrameType, event: str, result: Any) -> None:
        if event not in ("call", "return"):
            return
        name = self._name(frame.f_code)
        if not name:
            return
        if event == "call":
            code = frame.f_code
            count = code.co_argcount + code.co_kwonlyargcount
            values = [
                frame.f_locals[v]
                for v in code.co_varnames[:count]
                if v not in ("self", "cls") and v in frame.f_locals
            ]
        else:
            values = [result]
        carried = Carried()
        for value in values:
            carried.look(value)
        with self._lock:
            now, thread = time.monotonic(), threading.get_ident()
            line = (event, now, thread, name, sorted(carried.tags), sorted(carried.types))
            self._out.write(json.dumps(line) + "\n")
            self._out.flush()


@dataclass(slots=True)
class Carried:
    """What a value carries: ``byte``, ``symbol``, a message on the wire (``wire:...``)."""

    tags: set[str] = field(default_factory=set)
    types: set[str] = field(default_factory=set)

    def look(self, value: Any, depth: int = DEPTH) -> bool:
        """Look into a value; whether it carries anything."""
        if isinstance(value, str | bytes):
            return self._text(value.encode() if isinstance(value, str) else value)
        if depth == 0 or value is None or isinstance(value, int | float | type):
            return False
        parts = list(_parts(value))
        found = False
        for _, part in parts:
            found |= self.look(part, depth - 1)
        if any(name in SYMBOL_NAMES for name, _ in parts):
            self.tags.add("symbol")
            found = True
        if found and type(value).__module__.split(".")[0] in _ROOMS:
            self.types.add(f"{type(value).__module__}.{type(value).__qualname__}")
        return found

    def _text(self, text: bytes) -> bool:
        if text.startswith(b'{"v"'):
            message = json.loads(text)
            if "cipher" in message and "k" in message:
                self.tags.add(f"wire:offer:{message['k']}")
                return True
            if message.get("payload") in (BYTE, base64.b64encode(BYTE.encode()).decode()):
                self.tags.add("wire:command")
                return True
            return False
        if text in (BYTE.encode(), base64.b64encode(BYTE.encode())):
            self.tags.add("byte")
            return True
        return False


_ROOMS: Final = (
    "protocol",
    "runtime",
    "controller_service",
    "plant_service",
    "tap_service",
    "wyner",
)


def _parts(value: Any) -> Iterator[tuple[str, Any]]:
    """Fields of a wrapper, by name; items of a sequence, nameless."""
    if isinstance(value, tuple | list):
        names: Iterable[str] = getattr(value, "_fields", None) or [""] * len(value)
        yield from zip(names, value, strict=True)
    elif hasattr(type(value), "model_fields"):
        for name in type(value).model_fields:
            yield name, getattr(value, name, None)
    elif is_dataclass(value):
        yield from ((f.name, getattr(value, f.name, None)) for f in fields(value))


def record(file: str, arguments: list[str]) -> int:
    """Run the command in this process, traced."""
    from wyner.cli.main import main

    with Path(file).open("w") as out:
        Recorder(out).start()
        try:
            return main(arguments)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)


# --- what was traced -----------------------------------------------------------------------------


@dataclass(slots=True)
class Call:
    """A call of one of the project's functions, and those made from it."""

    name: str
    began_s: float
    tags: set[str]
    types: set[str]
    calls: list["Call"] = field(default_factory=list)
    ended_s: float = inf

    def walk(self, depth: int = 0) -> Iterator[tuple[int, "Call"]]:
        """This call and all within, in order, with their depth."""
        yield depth, self
        for call in self.calls:
            yield from call.walk(depth + 1)


def calls_of(file: Path) -> list[Call]:
    """The outermost calls of a recording; a service's loops are opened, so that steps remain."""
    roots: list[Call] = []
    open_calls: dict[int, list[Call]] = {}
    for line in file.read_text().splitlines():
        event, at_s, thread, name, tags, types = json.loads(line)
        stack = open_calls.setdefault(thread, [])
        if event == "call":
            call = Call(name, at_s, set(tags), set(types))
            (stack[-1].calls if stack else roots).append(call)
            stack.append(call)
        elif stack and stack[-1].name == name:
            call = stack.pop()
            call.ended_s = at_s
            call.tags.update(tags)
            call.types.update(types)
    return [step for root in roots for step in _steps(root)]


def _steps(call: Call) -> Iterator[Call]:
    if call.ended_s - call.began_s < LOOP_S:
        yield call
        return
    for inner in call.calls:
        yield from _steps(inner)


class Part(NamedTuple):
    """One activity on the byte's way."""

    name: str
    calls: list[Call]

    def frames(self) -> list[str]:
        """Functions entered, each once, in order."""
        return list(dict.fromkeys(c.name for call in self.calls for _, c in call.walk()))

    def carrying(self) -> list[str]:
        """Of these the functions that were handed the byte, or gave it back."""
        found = (c.name for call in self.calls for _, c in call.walk() if c.tags)
        return list(dict.fromkeys(found))

    def types(self) -> set[str]:
        """Wrappers of the byte."""
        return {t for call in self.calls for _, c in call.walk() for t in c.types}


def _having(calls: list[Call], tag: str) -> list[Call]:
    return [call for call in calls if any(tag in c.tags for _, c in call.walk())]


# --- a real run ----------------------------------------------------------------------------------


class Run:
    """Plant, controller and one ``wyner send``, each traced into a file of ``folder``.

    Parameters
    ----------
    folder : Path
    scenario : str
        A shipped name or a file.
    """

    def __init__(self, folder: Path, scenario: str) -> None:
        self.folder, self.scenario = folder, scenario
        field_at, management_at, commands_at = free_endpoints(3)
        self._plant = ["--listen", f"field={field_at}", "--listen", f"management={management_at}"]
        self._controller = [
            "--connect",
            f"field={field_at}",
            "--connect",
            f"management={management_at}",
        ]
        self._controller += ["--listen", f"management={commands_at}"]
        self._operator = ["--connect", f"management={commands_at}"]

    def make(self) -> None:
        """Run until the plant has the message.

        Raises
        ------
        RuntimeError
            When it has it not in time.
        """
        from runtime.run_folder import PLANT_TRACE

        common = ["--scenario", self.scenario, "--run-dir", str(self.folder / "run")]
        services = [
            self._start("plant", ["plant", *common, "--pace", "x5", *self._plant]),
            self._start("controller", ["controller", *common, *self._controller]),
        ]
        try:
            self._start("send", ["send", BYTE, "--timeout", "30", *self._operator]).wait(START_S)
            trace, until = self.folder / "run" / PLANT_TRACE, time.monotonic() + START_S
            while '"event":"recovered"' not in (trace.read_text() if trace.exists() else ""):
                if time.monotonic() > until:
                    raise RuntimeError(f"no message at the plant after {START_S:g} s")
                time.sleep(0.2)
        finally:
            for service in services:
                service.send_signal(signal.SIGTERM)
            for service in services:
                service.wait(20)

    def parts(self) -> list[Part]:
        """The four activities."""
        from runtime.run_folder import PLANT_TRACE

        lines = (self.folder / "run" / PLANT_TRACE).read_text().splitlines()
        last, k = -1, -1
        for event in map(json.loads, lines):
            if event["event"] == "transition":
                last = event["k"]
            if event["event"] == "recovered":
                k = last
                break
        calls = {name: calls_of(self._file(name)) for name in ("send", "controller", "plant")}
        sending = [call for root in calls["send"] for call in _first_carrying(root)]
        offer = f"wire:offer:{k}"
        return [
            Part("send", sending),
            Part("queue", _having(calls["controller"], "wire:command")),
            Part("decide", _having(calls["controller"], offer)),
            Part("decode", _having(calls["plant"], offer)),
        ]

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.calls"

    def _start(self, name: str, arguments: list[str]) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "tools.follow", "--record", str(self._file(name))]
        env = os.environ | {"PYTHONPATH": str(ROOT)}
        return subprocess.Popen([*command, "--", *arguments], cwd=ROOT, env=env)


def _first_carrying(call: Call) -> Iterator[Call]:
    """The parts of a call tree that begin where the byte is first handed on."""
    if call.tags:
        yield call
        return
    for inner in call.calls:
        yield from _first_carrying(inner)


def report(parts: list[Part], *, walk: bool) -> str:
    """The figures, and with ``walk`` every call in order."""
    lines: list[str] = []
    for part in parts:
        own = f"{len(part.frames())} frames, {len(part.carrying())} of them carry"
        lines.append(f"{part.name:<8}{own}, {len(part.types())} types")
        if walk:
            for call in part.calls:
                lines += [
                    f"  {'*' if c.tags else ' '} {'  ' * depth}{c.name}" for depth, c in call.walk()
                ]
    frames = dict.fromkeys(name for part in parts for name in part.frames())
    carrying = dict.fromkeys(name for part in parts for name in part.carrying())
    types = sorted({t for part in parts for t in part.types()})
    lines.append(
        f"in all  {len(frames)} frames, {len(carrying)} of them carry, {len(types)} types:"
    )
    lines += [f"  {name}" for name in types]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["--record"]:
        return record(given[1], given[3:])
    parser = argparse.ArgumentParser(prog="python -m tools.follow", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--scenario", default="packed", metavar="S", help="(default: packed)")
    parser.add_argument("--what", choices=("byte", "step"), default="byte")
    parser.add_argument("--walk", action="store_true", help="every call, in order")
    args = parser.parse_args(given)
    with tempfile.TemporaryDirectory(prefix="follow-") as folder:
        run = Run(Path(folder), args.scenario)
        run.make()
        parts = run.parts()
    print(report(parts if args.what == "byte" else parts[-1:], walk=args.walk))
    return 0


if __name__ == "__main__":
    sys.exit(main())
