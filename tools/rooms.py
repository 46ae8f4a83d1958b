"""Counts each room: files, lines, types and functions: ``python -m tools.rooms [REVISION ...]``.

Without a revision it counts the working tree as git has it (``HEAD``). With two it shows what came
and what went. A room is a folder at the top; a type is a class; a function is one with a name.
"""

import argparse
import ast
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, NamedTuple, Self

ROOT: Final = Path(__file__).resolve().parents[1]


class Size(NamedTuple):
    """How large a room is."""

    files: int = 0
    lines: int = 0
    types: int = 0
    functions: int = 0

    def with_file(self, source: str) -> Self:
        """The room with one file more."""
        nodes = list(ast.walk(ast.parse(source)))
        return type(self)(
            self.files + 1,
            self.lines + source.count("\n"),
            self.types + sum(isinstance(node, ast.ClassDef) for node in nodes),
            self.functions
            + sum(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in nodes),
        )


def sizes(files: Iterable[tuple[str, str]]) -> dict[str, Size]:
    """The size of each room, by name.

    Parameters
    ----------
    files : iterable of (str, str)
        Path from the top, and text.
    """
    rooms: dict[str, Size] = {}
    for path, source in files:
        room, slash, _ = path.partition("/")
        if slash and path.endswith(".py"):
            rooms[room] = rooms.get(room, Size()).with_file(source)
    return dict(sorted(rooms.items()))


def files_of(revision: str) -> Iterable[tuple[str, str]]:
    """Path and text of each Python file of a revision.

    Raises
    ------
    LookupError
        When git knows no such revision.
    """
    listed = _git("ls-tree", "-r", "--name-only", revision)
    for path in listed.splitlines():
        if path.endswith(".py"):
            yield path, _git("show", f"{revision}:{path}")


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LookupError(done.stderr.strip().splitlines()[0])
    return done.stdout


def table(columns: Mapping[str, Mapping[str, Size]]) -> str:
    """A row for each room and, for each revision, its four figures."""
    names = sorted({room for rooms in columns.values() for room in rooms})
    heading = f"{'':<20}" + "".join(f"{revision:>28}" for revision in columns)
    fields = f"{'room':<20}" + f"{'files':>6}{'lines':>8}{'types':>6}{'funcs':>8}" * len(columns)
    rows = [heading, fields]
    for name in names:
        found = (rooms.get(name, Size()) for rooms in columns.values())
        rows.append(
            f"{name:<20}"
            + "".join(f"{s.files:>6}{s.lines:>8}{s.types:>6}{s.functions:>8}" for s in found)
        )
    return "\n".join(rows)


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tools.rooms", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("revision", nargs="*", default=["HEAD"])
    args = parser.parse_args(arguments)
    try:
        print(table({revision: sizes(files_of(revision)) for revision in args.revision}))
    except LookupError as error:
        print(f"rooms: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
