"""A message on the command line is everybody's to read: it is taken off before all else."""

import os
import sys
from collections.abc import Sequence
from typing import Final

SECRET: Final = "--message"
REPLACEMENT: Final = "--message-file"


def without_message(arguments: Sequence[str], path: str) -> tuple[list[str], str | None]:
    """``arguments`` with ``--message TEXT`` as ``--message-file path``, and the text if any."""
    kept: list[str] = []
    text: str | None = None
    rest = iter(arguments)
    for argument in rest:
        if argument == SECRET:
            text = next(rest, None)
            kept += [SECRET] if text is None else [REPLACEMENT, path]
        elif argument.startswith(f"{SECRET}="):
            text = argument.partition("=")[2]
            kept += [REPLACEMENT, path]
        else:
            kept.append(argument)
    return kept, text


def hide_message() -> None:
    """Start this process anew with the message in a pipe, where its command line holds one.

    A process's arguments are shown by ``ps`` to every user of the machine. The text is left as it
    is where it would not fit into a pipe: then it is too long for a message as well.
    """
    if not any(a.partition("=")[0] == SECRET for a in sys.argv[1:]):
        return
    reading, writing = os.pipe()
    arguments, text = without_message(sys.orig_argv[1:], f"/dev/fd/{reading}")
    payload = b"" if text in (None, "-") else os.fsencode(text)
    os.set_blocking(writing, False)
    try:
        fits = bool(payload) and os.write(writing, payload) == len(payload)
    except BlockingIOError:
        fits = False
    os.close(writing)
    if not fits:
        os.close(reading)
        return
    os.set_inheritable(reading, True)
    os.execv(sys.executable, [sys.executable, *arguments])
