"""Which loops a host runs: a single one, those of a file, or so many of one scenario.

    [[loop]]
    id = "boiler-1"
    scenario = "sustained"
    message = "meet at noon"
    seed = 1

Each loop has a folder of its own below the run's, by its id.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
)

from protocol.schemes.framing import MAX_PAYLOAD
from protocol.topics import DEFAULT_LOOP, check_loop
from protocol.wrong_fields import wrong_fields
from runtime.bus_options import ServiceOptions
from runtime.errors import UsageError
from runtime.files import read_toml

SLOTS = 20
"""Phases over which the ticks of a fleet are spread: some at once cost less than each alone, and
all at once would wait for one another."""

FLEET_STATUS_S = 1.0
"""Seconds between statuses of each loop of a fleet."""

LARGEST_FLEET = 10_000


def _payload(message: object) -> bytes:
    """A message as it is sent; a file has it as text."""
    payload = message.encode() if isinstance(message, str) else message
    if not isinstance(payload, bytes) or len(payload) > MAX_PAYLOAD:
        raise ValueError(f"expected a text of at most {MAX_PAYLOAD} bytes")
    return payload


class FleetLoop(BaseModel):
    """One loop of a fleet; ``seed`` is for experiments only."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: Annotated[str, AfterValidator(check_loop)]
    scenario: str = "sustained"
    message: Annotated[bytes, BeforeValidator(_payload)] = b""
    seed: Annotated[int | None, Field(ge=0)] = None


class _FleetFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    loop: tuple[FleetLoop, ...]

    @field_validator("loop")
    @classmethod
    def _told_apart(cls, loops: tuple[FleetLoop, ...]) -> tuple[FleetLoop, ...]:
        if not loops:
            raise ValueError("expected a loop at least")
        if len({loop.id for loop in loops}) < len(loops):
            raise ValueError("expected an id for each of its own")
        return loops


def loops_of(options: ServiceOptions, message: bytes | None = None) -> Sequence[FleetLoop]:
    """The loops that the options name: those of a file, so many numbered ones, or a single one.

    Those that stand in no file have one scenario and one ``message``; numbered ones are
    ``loop-0000`` and on, and each has a seed of its own.

    Raises
    ------
    UsageError
        When the file or the number is wrong, or an option beside it is for a single loop.
    """
    names, seed = [options.loop], options.seed
    if options.fleet is not None:
        if options.loop != DEFAULT_LOOP:
            raise UsageError("--loop: is for a single loop; a fleet's loops have ids of their own")
        if not options.fleet.isdecimal():
            return read_fleet(Path(options.fleet))
        count = int(options.fleet)
        if not 1 <= count <= LARGEST_FLEET:
            raise UsageError(f"--fleet: got {count}, expected 1 to {LARGEST_FLEET}")
        names = [f"loop-{number:04d}" for number in range(count)]
    return [
        FleetLoop(
            id=name,
            scenario=options.scenario or "",
            message=message or b"",
            seed=None if seed is None else seed + number,
        )
        for number, name in enumerate(names)
    ]


def read_fleet(path: Path) -> Sequence[FleetLoop]:
    """The loops of a file.

    Raises
    ------
    UsageError
        With a line for each wrong field.
    """
    tables = read_toml(path)
    try:
        return _FleetFile.model_validate(tables).loop
    except ValidationError as error:
        raise UsageError([f"{path}: {line}" for line in wrong_fields(error)]) from None
