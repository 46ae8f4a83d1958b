"""Options: a dataclass says them once, and command line, help and reference come from it."""

import argparse
import os
import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from datetime import UTC, datetime
from inspect import get_annotations
from pathlib import Path
from typing import Any, Final, TypeVar, cast, get_args, get_type_hints

from protocol.schemes.framing import MAX_PAYLOAD
from runtime.errors import DONE, UsageError, writing
from runtime.files import PRIVATE_FOLDER, make_folder, open_regular
from runtime.pace import Pace

STDIN: Final = "-"
"""In place of a text or a file: no other process can read it, as all can a command line."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a command line's help says of an option, and what a value of it must be.

    ``group`` is a title, with a description on a second line if need be; of those that share
    ``either`` one may be given. Of ``many`` the option may be repeated.
    """

    help: str
    metavar: str | None = None
    least: int | None = None
    many: bool = False
    group: str = ""
    either: str = ""


def option(help: str, metavar: str | None = None, default: Any = None, **told: Any) -> Any:
    """A field of a dataclass of options; one whose default is ``...`` has to be given."""
    metadata = {"told": Told(help, metavar, **told)}
    if default is ...:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


def add_arguments(parser: argparse.ArgumentParser, kind: type, **words: str) -> None:
    """Add the options that a dataclass has.

    Parameters
    ----------
    parser : ArgumentParser
    kind : type
        Its fields are made by :func:`option`; the name, the type and the default are the field's.
    words : str
        What braces in a group's description stand for.
    """
    hints = get_type_hints(kind)
    groups: dict[str, argparse._ActionsContainer] = {}
    by_name = {one.name: one for one in fields(kind)}
    own_first = dict.fromkeys(n for part in kind.__mro__ for n in get_annotations(part))
    for one in (by_name[name] for name in own_first):
        told: Told = one.metadata["told"]
        place: argparse._ActionsContainer = parser
        if told.group:
            if told.group not in groups:
                title, _, about = told.group.partition("\n")
                group = parser.add_argument_group(title, about.format(**words) or None)
                groups[told.group] = group
            place = groups[told.group]
        if told.either:
            if told.either not in groups:
                groups[told.either] = place.add_mutually_exclusive_group()
            place = groups[told.either]
        name = f"--{one.name.replace('_', '-')}"
        if hints[one.name] is bool:
            place.add_argument(name, action="store_true", help=told.help)
            continue
        place.add_argument(
            name,
            action="append" if told.many else "store",
            type=_number(hints[one.name]),
            required=one.default is MISSING,
            default=None if told.many or one.default is MISSING else one.default,
            metavar=told.metavar,
            help=told.help,
        )


def fine(what: str) -> int:
    """Say that what ``--check`` looked at can be started; returns the exit code."""
    print(f"{what}: fine")
    return DONE


def _number(hint: Any) -> type:
    """What makes a value of a text, for a field of this type."""
    for kind in (int, float):
        if kind in (hint, *get_args(hint)):
            return kind
    return str


Options = TypeVar("Options")


def picked(kind: type[Options], parsed: Mapping[str, object]) -> Options:
    """A dataclass of options out of a parsed command line, by the names of its fields.

    Parameters
    ----------
    kind : type
        A dataclass; a field that was not given keeps its default.
    parsed : mapping
        ``vars`` of what argparse made.

    Raises
    ------
    UsageError
        When a number is smaller than it may be.
    """
    given = {}
    for one in fields(cast(Any, kind)):
        value = parsed.get(one.name)
        if value is not None:
            given[one.name] = value
            if (least := one.metadata["told"].least) is not None:
                at_least(f"--{one.name.replace('_', '-')}", cast(int, value), least)
    return kind(**given)


@dataclass(frozen=True, kw_only=True)
class MessageOptions:
    """What to deliver."""

    message: str | None = option(
        "the message to deliver; - reads it from standard input, @FILE from a file", "TEXT"
    )


def message_of(text: str | None) -> bytes | None:
    """The bytes of a message, if one is given: `STDIN` reads standard input, ``@FILE`` a file.

    Standard input loses its last newline, which ``echo`` and Enter add. A file's bytes stay as
    they are.

    Raises
    ------
    UsageError
        When the file cannot be read, or the message is empty or too long for one frame.
    """
    if text is None:
        return None
    if text == STDIN:
        if os.isatty(0):
            print("type the message; Enter, then Ctrl-D end it", file=sys.stderr, flush=True)
        payload = _read(Path("/dev/stdin")).removesuffix(b"\n")
    elif text.startswith("@"):
        payload = _read(Path(text[1:]))
    else:
        payload = text.encode("utf-8", errors="surrogateescape")
    if not 0 < len(payload) <= MAX_PAYLOAD:
        size = len(payload) if len(payload) <= MAX_PAYLOAD else f"more than {MAX_PAYLOAD}"
        raise UsageError(f"message: got {size} bytes, expected 1 to {MAX_PAYLOAD}")
    return payload


def _read(path: Path) -> bytes:
    """What a message may be of a file; standard input may be a pipe, other files may not."""
    try:
        with path.open("rb") if path == Path("/dev/stdin") else open_regular(path) as source:
            return source.read(MAX_PAYLOAD + 2)
    except OSError as error:
        raise UsageError(f"message: {path}: cannot be read: {error.strerror}") from None


def pace_of(text: str) -> Pace:
    """The checked ``--pace``."""
    try:
        return Pace(text)
    except ValueError as error:
        raise UsageError(f"--pace: {error}") from None


def folder_of(option: str, value: str | None, default: Path) -> Path:
    """The folder that an option names, or the default.

    Raises
    ------
    UsageError
        When there is no such folder.
    """
    if value is None:
        return default
    if not Path(value).is_dir():
        raise UsageError(f"{option}: got {value!r}, expected a folder that is there")
    return Path(value)


def run_dir_of(text: str | None) -> Path:
    """The run's folder: the one given, or a new one below ``runs``, made.

    Raises
    ------
    UsageError
        When it cannot be made.
    Failure
        When the disk is full or broken.
    """
    if text is None:
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
        for attempt in range(1000):
            path = Path("runs") / (stamp if attempt == 0 else f"{stamp}-{attempt}")
            with writing(f"--run-dir: {path}"):
                make_folder(path.parent)
                try:
                    path.mkdir(mode=PRIVATE_FOLDER)
                except FileExistsError:
                    continue
                return path
    if not text:
        raise UsageError("--run-dir: got '', expected a folder")
    path = Path(text)
    with writing(f"--run-dir: {path}"):
        make_folder(path)
    return path


def at_least(option: str, value: int | None, least: int) -> None:
    """Check a whole number that an option may give.

    Raises
    ------
    UsageError
        When it is smaller.
    """
    if value is not None and value < least:
        raise UsageError(f"{option}: got {value}, expected at least {least}")
