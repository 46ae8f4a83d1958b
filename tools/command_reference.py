"""The reference of every command and its options: ``python -m tools.command_reference`` prints it.

The site is built with it (``docs/conf.py``).
"""

import contextlib
import io
import os
from typing import Final

from wyner.cli.main import build_parser, groups

COLUMNS: Final = "100"
HEAD: Final = """\
# Commands

What `wyner COMMAND --help` prints.

Every command ends with one of these exit codes:

- **0**: done.
- **1**: done, and something was found (a broken rule, a warning, an eavesdropper that failed, a
  loop that carries nothing); or it failed (no answer, a full disk, a service that died).
- **2**: wrong use: an option, or a file that the command line names and that is missing, malformed
  or cannot be written.
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


if __name__ == "__main__":
    print(page(), end="")
