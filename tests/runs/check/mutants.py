"""Every way in which one recorded field of one file of a run can be otherwise."""

import json
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, MANIFEST, PLANT_TRACE
from tests.support.checked_runs import failed
from tests.support.recorded_pair import Lines, read_lines, write_lines


@dataclass(frozen=True)
class Mutant:
    """A run's file with one thing changed.

    Parameters
    ----------
    file : Path
    kind : str
        Event or topic of the line that is changed.
    field : str
        The field, empty where the whole line is meant.
    how : str
    lines : list
        The file's new content.
    """

    file: Path
    kind: str
    field: str
    how: str
    lines: Lines

    @property
    def name(self) -> str:
        """Which one it is."""
        return f"{self.file}: {self.kind} {self.field} {self.how}"


def failed_by(m: Mutant, folder: Path) -> set[str]:
    """The rules that a run fails with this change. The folder is left as it was."""
    before = (folder / m.file).read_bytes()
    write_lines(folder / m.file, m.lines)
    found = failed(folder)
    (folder / m.file).write_bytes(before)
    return found


def kind_of(line: dict[str, Any]) -> str:
    """Event, with the topic of a message."""
    return str(line["topic"] if line["event"] == "field" else line["event"])


def small(value: object) -> object:
    """Another value, as near as can be told."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value + 1e-9 * max(1.0, abs(value))
    if isinstance(value, str):
        return value[:-1] + ("0" if value[-1:] != "0" else "1")
    if isinstance(value, list):
        return [*value[:-1], small(value[-1])] if value else [0.5]
    return "0" * 16


def large(value: object) -> object:
    """Another value, far away or of another type."""
    if isinstance(value, int):
        return value + 1_000_000
    if isinstance(value, float):
        return value * 3 + 100.0
    if isinstance(value, str):
        return value + "\x1b[31m" * 20
    if isinstance(value, list):
        return [large(v) for v in value] if value else [1e300, 1e300]
    return 7


def shorter(value: object) -> object:
    """What is a vector, a number short; else a list."""
    return value[:-1] if isinstance(value, list) and value else [value]


def huge(value: object) -> object:
    """Numbers beyond what 64 bits hold, and about the largest there are; what has none stays."""
    if isinstance(value, int):
        return 2**70
    if isinstance(value, float):
        return 1.7e308
    return [huge(v) for v in value] if isinstance(value, list) else value


ALTERATIONS: dict[str, Callable[[object], object]] = {
    "small": small,
    "large": large,
    "huge": huge,
    "shorter": shorter,
    "null": lambda _value: None,
    "text": str,
}


def places(lines: Lines) -> dict[str, int]:
    """One line of each kind, some way into the run where there is one."""
    found: dict[str, int] = {}
    for i, line in enumerate(lines):
        kind = kind_of(line)
        if line.get("role") == "message":
            kind += " message"
        elif line.get("symbol", -1) >= 0:
            kind += " agreed"
        if len({str(u) for u in line.get("candidates", (0, 1))}) < 2:
            continue  # whichever was applied
        if kind not in found or (i > len(lines) // 3 > found[kind]):
            found[kind] = i
    return found


def unnoticed(folder: Path, file: Path, fields: Mapping[str, Collection[str]]) -> list[str]:
    """Changes of these fields of a run's lines, by kind, after which it is as right as before.

    The folder is left as it was.
    """
    known = failed(folder)
    return [
        m.name
        for m in of_file(folder, file)
        if m.field in fields.get(m.kind.partition(" ")[0], ())
        and m.how in ("small", "large", "deleted")
        and failed_by(m, folder) <= known
    ]


def of_file(folder: Path, file: Path) -> Iterator[Mutant]:
    """Every mutant of a recording."""
    lines = read_lines(folder / file)
    for kind, at in places(lines).items():
        for field, how, instead in _of_line(lines[at]):
            yield Mutant(file, kind, field, how, [*lines[:at], *instead, *lines[at + 1 :]])
        if at + 1 < len(lines):
            swapped = [*lines[:at], lines[at + 1], lines[at], *lines[at + 2 :]]
            yield Mutant(file, kind, "", "swapped", swapped)
    for cut in (len(lines) // 2, len(lines) - 6):
        yield Mutant(file, "", "", f"cut after {cut} of {len(lines)}", lines[:cut])


def _of_line(line: dict[str, Any]) -> Iterator[tuple[str, str, Lines]]:
    """What may stand instead of a line: the field that differs, how, and the lines."""
    body = line.get("message", line)

    def whole(changed: dict[str, Any]) -> Lines:
        return [line | {"message": changed} if "message" in line else changed]

    for field, value in body.items():
        for how, alter in ALTERATIONS.items():
            if alter(value) != value:
                yield field, how, whole(body | {field: alter(value)})
        yield field, "deleted", whole({k: v for k, v in body.items() if k != field})
    yield "unheard_of", "added", whole(body | {"unheard_of": 1})
    if "message" in line:
        for field in ("t_ns", "topic"):
            yield field, "small", [line | {field: small(line[field])}]
    yield "", "deleted", []
    yield "", "repeated", [line, line]


def of_manifest(folder: Path) -> Iterator[Mutant]:
    """The manifest's fields that say of which scenario the run is."""
    manifest = json.loads((folder / MANIFEST).read_text())
    for field in ("scenario", "fingerprint", "loop"):
        for how in ("small", "large", "null"):
            changed = manifest | {field: ALTERATIONS[how](manifest[field])}
            yield Mutant(MANIFEST, "manifest", field, how, [changed])
        lacking = {k: v for k, v in manifest.items() if k != field}
        yield Mutant(MANIFEST, "manifest", field, "deleted", [lacking])


def mutants_of(folder: Path) -> list[Mutant]:
    """All of them."""
    files = (PLANT_TRACE, CONTROLLER_TRACE, CAPTURE)
    return [m for file in files for m in of_file(folder, file)] + list(of_manifest(folder))
