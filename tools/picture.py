"""The picture in the documentation, made from statuses that a seeded run really published.

``python -m tools.picture`` draws ``docs/dashboard.svg`` from ``docs/dashboard.jsonl``; the same
recording gives the same bytes. ``--record`` makes the recording anew from a running system.
"""

import argparse
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from pydantic_core import to_json

from protocol.messages import ControllerStatus, PlantModel, PlantStatus, TapStatus
from runtime.recording import read_lines
from wyner.dashboard.model import Arrival, State, reduce_all
from wyner.dashboard.screenshot import to_svg
from wyner.dashboard.source import ADVERSARY_WATCHED, MANAGEMENT_WATCHED, BusSource
from wyner.dashboard.view import ViewState, screen

DOCS: Final = Path(__file__).resolve().parent.parent / "docs"
RECORDING: Final = "dashboard.jsonl"
PICTURE: Final = "dashboard.svg"
SIZE: Final = (110, 36)

STEPS_RECORDED: Final = 1000
"""Steps before the pictured moment that a recording holds."""

_TYPES: Final = {kind.topic: kind for kind in (*MANAGEMENT_WATCHED, *ADVERSARY_WATCHED)}


def read(path: Path) -> list[Arrival]:
    """The arrivals of a recording."""
    arrivals = []
    for line in read_lines(path):
        record = line.value
        if record is None:
            raise ValueError(f"{path}: line {line.number}: expected a JSON object")
        message = _TYPES[record["topic"]].model_validate_json(to_json(record["message"]))
        arrivals.append(Arrival(record["t_ns"], message))
    return arrivals


def write(path: Path, arrivals: Iterable[Arrival]) -> None:
    """Write a recording, one arrival a line."""
    with path.open("wb") as file:
        for arrival in arrivals:
            message = arrival.message
            record = {"t_ns": arrival.t_ns, "topic": type(message).topic, "message": message}
            file.write(to_json(record) + b"\n")


def draw(arrivals: Iterable[Arrival], width: int, height: int) -> str:
    """The screen after the last arrival, as SVG."""
    arrivals = list(arrivals)
    state = reduce_all(State(), arrivals)
    shown = screen(state, width, height, ViewState(), arrivals[-1].t_ns)
    return to_svg(shown, (width, height))


def thin(arrivals: Sequence[Arrival], k: int) -> list[Arrival]:
    """What is needed to draw the last agreement up to step ``k``: the newest of each, and tails.

    Of the earlier statuses of a plant or a tap as few are kept as have all of the last steps.
    """
    moment = [a for a in arrivals if not isinstance(a.message, PlantStatus) or a.message.k <= k]
    last = next(i for i in reversed(range(len(moment))) if _is_agreement(moment[i]))
    said: dict[str, list[Arrival]] = {}
    for arrival in moment[: last + 1]:
        match arrival.message:
            case PlantStatus() | ControllerStatus() | PlantModel() as message:
                said.setdefault(type(message).topic, []).append(arrival)
            case TapStatus(name=name):
                said.setdefault(name, []).append(arrival)
    kept = {id(arrival) for its in said.values() for arrival in _covering(its, k - STEPS_RECORDED)}
    return [arrival for arrival in moment if id(arrival) in kept]


def _covering(its: Sequence[Arrival], oldest: int) -> Iterator[Arrival]:
    """The newest, and before it those that leave the least gap and reach back furthest."""
    yield its[-1]
    tails = {id(a): getattr(a.message, "tail_k", ()) for a in its}
    first = min(tails[id(its[-1])], default=-1)
    while first > oldest:
        spans = [(tail[0], tail[-1], a) for a in its if (tail := tails[id(a)]) and tail[0] < first]
        if not spans:
            return
        least = min(max(0, first - 1 - last) for _, last, _ in spans)
        first, _, best = min(
            (span for span in spans if first - 1 - span[1] <= least), key=lambda span: span[0]
        )
        yield best


def _is_agreement(arrival: Arrival) -> bool:
    return isinstance(arrival.message, PlantStatus) and arrival.message.pictured_symbol >= 0


def record(until_k: int) -> list[Arrival]:
    """Listen to the one run of ``wyner up`` on this machine until it is past step ``until_k``."""
    from runtime.zenoh_bus import ZenohBus
    from wyner.deployment.running import running_loops

    (loop,) = running_loops()
    arrivals: list[Arrival] = []
    ends = [loop.plant_management, loop.controller_management]
    with ZenohBus(connect=ends) as management, ZenohBus(connect=[loop.adversary]) as adversary:
        source = BusSource(management, adversary, loop.loop)
        while not any(
            isinstance(a.message, PlantStatus) and a.message.k > until_k for a in arrivals
        ):
            arrivals += source.drain()
            time.sleep(0.02)
    return arrivals


def main(argv: Sequence[str] | None = None) -> int:
    """Draw the picture, after recording where asked."""
    parser = argparse.ArgumentParser(prog="python -m tools.picture", description=main.__doc__)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder of recording and picture")
    parser.add_argument(
        "--record", type=int, metavar="K", help="record a running system up to step K first"
    )
    args = parser.parse_args(argv)
    recording = args.docs / RECORDING
    if args.record is not None:
        write(recording, thin(record(args.record), args.record))
    try:
        arrivals = read(recording)
    except OSError as error:
        print(f"{recording}: cannot be read: {error.strerror}", file=sys.stderr)
        return 1
    (args.docs / PICTURE).write_text(draw(arrivals, *SIZE), encoding="utf-8")
    print(args.docs / PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
