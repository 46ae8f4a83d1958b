"""Fleets: which loops a host runs, by a file or by their number.

    [[loop]]
    id = "boiler-1"
    scenario = "sustained"
    message = "meet at noon"
    seed = 1

A fleet's file may change while hosts run: they look at it once a second, take in the loops that are
new, and let those go that are gone. Each loop has a folder of its own below the run's, by its id.
"""

import logging
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from protocol.schemes.framing import MAX_PAYLOAD
from protocol.topics import check_loop
from protocol.wrong_fields import expected_of
from runtime.errors import UsageError
from runtime.files import read_regular

SLOTS = 20
"""Phases over which the ticks of a fleet are spread: some at once cost less than each alone, and
all at once would wait for one another."""

STATUS_S = 1.0
"""Seconds between statuses of each loop."""

LARGEST_FLEET = 10_000


class FleetLoop(BaseModel):
    """One loop of a fleet; ``seed`` is for experiments only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str
    scenario: str = "sustained"
    message: str = ""
    seed: Annotated[int | None, Field(ge=0)] = None

    @property
    def payload(self) -> bytes | None:
        """The message in bytes; None where there is none."""
        return self.message.encode("utf-8", errors="surrogateescape") or None


def numbered(count: int, scenario: str, message: str = "", seed: int | None = None) -> "Fleet":
    """``count`` loops of one scenario, ``loop-0000`` and on; each has a seed of its own.

    Raises
    ------
    UsageError
        When that is no number of loops.
    """
    if not 1 <= count <= LARGEST_FLEET:
        raise UsageError(f"--loops: got {count}, expected 1 to {LARGEST_FLEET}")
    loops = [
        FleetLoop(
            id=f"loop-{number:04d}",
            scenario=scenario,
            message=message,
            seed=None if seed is None else seed + number,
        )
        for number in range(count)
    ]
    return Fleet(lambda: {loop.id: loop for loop in loops})


def read_fleet(path: Path) -> dict[str, FleetLoop]:
    """The loops of a fleet's file, by id.

    Raises
    ------
    UsageError
        With a line for each wrong field.
    """
    try:
        tables = tomllib.loads(read_regular(path).decode())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not TOML: {error}") from None
    rows: Any = tables.pop("loop", None)
    if tables:
        raise UsageError(f"{path}: {next(iter(tables))}: expected tables [[loop]] only")
    if not isinstance(rows, list) or not rows:
        raise UsageError(f"{path}: loop: expected at least one table [[loop]]")
    loops: dict[str, FleetLoop] = {}
    problems = []
    for number, row in enumerate(rows, start=1):
        try:
            loop = FleetLoop.model_validate(row)
            check_loop(loop.id)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False)[0]
            field = ".".join(map(str, first["loc"]))
            problems.append(f"{path}: loop {number}: {field}: {expected_of(first)}")
            continue
        except ValueError as error:
            problems.append(f"{path}: loop {number}: id: {error}")
            continue
        if loop.id in loops:
            problems.append(f"{path}: loop {number}: id: {loop.id!r} is there already")
        if len(loop.message.encode("utf-8", errors="surrogateescape")) > MAX_PAYLOAD:
            problems.append(f"{path}: loop {number}: message: expected {MAX_PAYLOAD} bytes at most")
        loops[loop.id] = loop
    if problems:
        raise UsageError(problems)
    return loops


class Fleet:
    """The loops that there should be.

    Parameters
    ----------
    read : callable
        Them, by id, as they are now.
    path : Path, optional
        The file that ``read`` reads: it is read again when it has changed.

    Attributes
    ----------
    loops : dict
    path : Path or None
        As given.
    """

    def __init__(self, read: Callable[[], dict[str, FleetLoop]], path: Path | None = None) -> None:
        self._read = read
        self.path = path
        self._stamp = self._look()
        self.loops = read()

    @classmethod
    def of_file(cls, path: Path) -> "Fleet":
        """The fleet of a file.

        Raises
        ------
        UsageError
            As :func:`read_fleet` does.
        """
        return cls(lambda: read_fleet(path), path)

    def _look(self) -> tuple[int, int]:
        try:
            status = self.path.stat() if self.path is not None else None
        except OSError:
            return (-1, -1)
        return (0, 0) if status is None else (status.st_mtime_ns, status.st_size)

    def changed(self) -> bool:
        """Whether the file has changed; then it has been read again.

        Raises
        ------
        UsageError
            When it is not as expected any more; the loops stay what they were.
        """
        stamp = self._look()
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        self.loops = self._read()
        return True

    def left(self, known: Mapping[str, FleetLoop], log: logging.Logger) -> list[str]:
        """Read the file again. Returns those of the loops ``known`` that were removed or changed.

        Of a file that is not as expected any more a line is logged, and the loops stay.
        """
        try:
            self.changed()
        except UsageError as error:
            log.error("%s", error.lines[0])
        return [name for name, loop in known.items() if self.loops.get(name) != loop]
