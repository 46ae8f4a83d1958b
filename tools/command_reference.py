"""The page of every command and its options: ``python -m tools.command_reference --write``.

It is what ``wyner COMMAND --help`` prints, of one version of Python: others set it out otherwise.
"""

import contextlib
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from runtime.errors import DONE, USAGE
from runtime.files import PUBLIC_FILE, write_atomically
from wyner.cli.main import build_parser, groups

PAGE: Final = Path(__file__).resolve().parent.parent / "docs" / "command-reference.md"
PYTHON: Final = (3, 11)
"""The version that the page is made with."""
COLUMNS: Final = "100"
HEAD: Final = """\
# Commands

What `wyner COMMAND --help` prints. This page is made from the commands themselves
(`python -m tools.command_reference --write`).

Every command ends with one of these exit codes:

- **0**: done.
- **1**: done, and something was found (a broken rule, a warning, an eavesdropper that failed, a loop that carries
  nothing); or it could not be done (no answer, a full disk, a service that died).
- **2**: wrong use: an option, or a file that the command line names and that is missing, malformed or cannot be written.
  Nothing was started.
- **130**: Ctrl-C.
"""


def help_of(name: str) -> str:
    """What ``wyner NAME --help`` prints, on a screen of ``COLUMNS``."""
    told = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = COLUMNS
    try:
        with contextlib.redirect_stdout(told), contextlib.suppress(SystemExit):
            build_parser(name).parse_args([name, "--help"])
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    return told.getvalue()


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for group, commands in groups().items():
        parts.append(f"## {group.capitalize()}\n")
        for name in commands:
            parts.append(f"### wyner {name}\n\n```text\n{help_of(name)}```\n")
    return "\n".join(parts)


def main(arguments: Sequence[str] = ()) -> int:
    """Write the page, or print it."""
    if list(arguments) == ["--write"]:
        write_atomically(PAGE, page().encode(), PUBLIC_FILE)
        return DONE
    if arguments:
        print("usage: python -m tools.command_reference [--write]", file=sys.stderr)
        return USAGE
    print(page(), end="")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
