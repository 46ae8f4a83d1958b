"""Fleets: which loops a host runs, by a file or by their number.

    [[loop]]
    id = "boiler-1"
    scenario = "sustained"
    message = "meet at noon"
    seed = 1

Each loop has a folder of its own below the run's, by its id.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator

from protocol.schemes.framing import MAX_PAYLOAD
from protocol.topics import check_loop
from protocol.wrong_fields import wrong_fields
from runtime.errors import UsageError
from runtime.files import read_toml

SLOTS = 20
"""Phases over which the ticks of a fleet are spread: some at once cost less than each alone, and
all at once would wait for one another."""

STATUS_S = 1.0
"""Seconds between statuses of each loop."""

LARGEST_FLEET = 10_000


def _short(message: str) -> str:
    if len(message.encode("utf-8", errors="surrogateescape")) > MAX_PAYLOAD:
        raise ValueError(f"expected {MAX_PAYLOAD} bytes at most")
    return message


class FleetLoop(BaseModel):
    """One loop of a fleet; ``seed`` is for experiments only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: Annotated[str, AfterValidator(check_loop)]
    scenario: str = "sustained"
    message: Annotated[str, AfterValidator(_short)] = ""
    seed: Annotated[int | None, Field(ge=0)] = None

    @property
    def payload(self) -> bytes | None:
        """The message in bytes; None where there is none."""
        return self.message.encode("utf-8", errors="surrogateescape") or None


class _FleetFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    loop: Annotated[tuple[FleetLoop, ...], Field(min_length=1)]

    @field_validator("loop")
    @classmethod
    def _told_apart(cls, loops: tuple[FleetLoop, ...]) -> tuple[FleetLoop, ...]:
        if len({loop.id for loop in loops}) < len(loops):
            raise ValueError("expected an id for each of its own")
        return loops


@dataclass(frozen=True, slots=True)
class Fleet:
    """The loops that a host runs, by id; ``path`` is the file that lists them, if one does."""

    loops: dict[str, FleetLoop]
    path: Path | None = None


def numbered(count: int, scenario: str, message: str, seed: int | None) -> Fleet:
    """``count`` loops of one scenario, ``loop-0000`` and on; each has a seed of its own.

    Raises
    ------
    UsageError
        When that is no number of loops.
    """
    if not 1 <= count <= LARGEST_FLEET:
        raise UsageError(f"--fleet: got {count}, expected 1 to {LARGEST_FLEET}")
    loops = [
        FleetLoop(
            id=f"loop-{number:04d}",
            scenario=scenario,
            message=message,
            seed=None if seed is None else seed + number,
        )
        for number in range(count)
    ]
    return Fleet({loop.id: loop for loop in loops})


def text_of(message: bytes | None) -> str:
    """A message as :attr:`FleetLoop.message` has it; empty where there is none."""
    return (message or b"").decode("utf-8", errors="surrogateescape")


def read_fleet(path: Path) -> Fleet:
    """The fleet of a file.

    Raises
    ------
    UsageError
        With a line for each wrong field.
    """
    tables = read_toml(path)
    try:
        loops = _FleetFile.model_validate(tables).loop
    except ValidationError as error:
        raise UsageError([f"{path}: {line}" for line in wrong_fields(error)]) from None
    return Fleet({loop.id: loop for loop in loops}, path)
