"""What a run left behind, opened for checking, and given out part by part.

Nothing here judges. The traces come first, both ends side by side; the capture follows, to be
compared with the plant's steps. A run of millions of steps is never in memory as a whole.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from protocol.link.session import Rules, rules_of
from protocol.scenario import Scenario
from runtime.locks import refuse_running
from runtime.recording import parts_of
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE, SCENARIO
from wyner.runs.check.capture import CapturedMessage, CaptureLines
from wyner.runs.check.journals import JournalState, read_controller, read_plant
from wyner.runs.check.records import Item, MissedLine, Shape, Walked
from wyner.runs.check.sides import SideReader
from wyner.runs.check.steps import Steps
from wyner.runs.run import TRACES, Run

AT_ONCE: Final = 2000
"""Items that a part holds, about."""


class Pair(NamedTuple):
    """A transition as each side has it; None on the side that has not."""

    plant: Walked | None
    controller: Walked | None


class Part(NamedTuple):
    """A piece of a run: items of both traces and their transitions side by side, or messages."""

    plant: list[Item]
    controller: list[Item]
    pairs: list[Pair]
    seen: list[CapturedMessage]

    def sides(self) -> "tuple[tuple[str, list[Item]], tuple[str, list[Item]]]":
        """Both traces' items, with the side's name."""
        return ("plant", self.plant), ("controller", self.controller)


@dataclass(slots=True)
class Evidence:
    """Everything that a check looks at; what a run did not leave is None.

    Parameters
    ----------
    run : Run
    rules : Rules
    plant, controller : SideReader, optional
    plant_journal, controller_journal : JournalState or str, optional
        A string says why a journal cannot be read.
    wire : CaptureLines, optional
    steps : Steps
        The plant's steps, complete once the traces have been read.
    """

    run: Run
    rules: Rules
    plant: SideReader | None
    controller: SideReader | None
    plant_journal: JournalState | str | None
    controller_journal: JournalState | str | None
    wire: CaptureLines | None
    steps: Steps = field(init=False)

    def __post_init__(self) -> None:
        self.steps = Steps(Shape.of(self.rules))

    @property
    def run_dir(self) -> Path:
        """The run's folder."""
        return self.run.folder

    @property
    def scenario(self) -> Scenario:
        """The scenario that it was made under."""
        return self.run.scenario

    @property
    def manifest(self) -> dict[str, Any] | None:
        """None where there is none; empty where it is no JSON object."""
        return self.run.manifest

    def readers(self) -> Iterator[tuple[str, SideReader]]:
        """Both ends' traces, as far as they are there."""
        for reader in (self.plant, self.controller):
            if reader is not None:
                yield reader.side, reader

    @property
    def cut(self) -> str:
        """Which parts of the traces are gone, and what is judged of the rest; empty where none is.

        It is told once the traces have been read.
        """
        return "; ".join(
            f"parts 0 to {r.gone - 1} of the {name}'s trace are gone, "
            + (f"judged after transition {r.cut.j}" if r.cut else "nothing left can be judged")
            for name, r in self.readers()
            if r.gone
        )

    def before(self, seen: CapturedMessage) -> bool:
        """Whether a message is older than what is left of the plant's trace, and its answer."""
        return (
            self.plant is not None
            and self.plant.gone > 0
            and self.steps.before(seen.session, seen.k)
        )

    def parts(self) -> Iterator[Part]:
        """The run from its beginning to its end; can be asked for once."""
        yield from _Sides(self).parts()
        if self.wire is None:
            return
        seen: list[CapturedMessage] = []
        for one in self.wire:
            seen.append(one)
            if len(seen) == AT_ONCE:
                yield Part([], [], [], seen)
                seen = []
        yield Part([], [], [], seen)


class _Sides:
    """Both traces read side by side, so that neither has to be held."""

    def __init__(self, evidence: Evidence) -> None:
        self._e = evidence
        self._items = {side: iter(reader) for side, reader in evidence.readers()}
        self._over: set[str] = set()  # sessions that the plant has left
        cut = {side for side, reader in evidence.readers() if reader.gone}
        self._cut = cut if len(self._items) > 1 else set()
        self._part = Part([], [], [], [])
        self._plant: Walked | None = None
        self._controller: Walked | None = None

    def parts(self) -> Iterator[Part]:
        self._plant, self._controller = self._next("plant"), self._next("controller")
        while self._plant is not None or self._controller is not None:
            if self._meet():
                self._part.pairs.append(self._pair())
            if max(len(self._part.plant), len(self._part.controller)) >= AT_ONCE:
                yield self._part
                self._part = Part([], [], [], [])
        yield self._part

    def _meet(self) -> bool:
        """Whether both have come to where they can be compared; of cut traces, one step towards it.

        The plant's trace is the longer one, so of two that are cut it begins later.
        """
        plant, controller = self._plant, self._controller
        if not self._cut:
            return True
        if plant is not None and controller is not None:
            a, b = plant.t, controller.t
            if (a.session, a.j) == (b.session, b.j):
                self._cut.clear()
                return True
            behind = a.j < b.j if a.session == b.session else "plant" not in self._cut
        else:
            behind = plant is not None
        if behind:
            self._plant = self._next("plant")
        else:
            self._controller = self._next("controller")
        return False

    def _pair(self) -> Pair:
        plant, controller = self._plant, self._controller
        if plant is None:
            self._controller = self._next("controller")
        elif controller is None:
            self._plant = self._next("plant")
        elif plant.t.session == controller.t.session:
            if plant.t.j >= controller.t.j:
                self._controller = self._next("controller")
            if plant.t.j <= controller.t.j:
                self._plant = self._next("plant")
            if plant.t.j > controller.t.j:
                plant = None
            elif plant.t.j < controller.t.j:
                controller = None
        elif controller.t.session in self._over:
            self._controller = self._next("controller")
            plant = None
        else:
            self._plant = self._next("plant")
            controller = None
        return Pair(plant, controller)

    def _next(self, side: str) -> Walked | None:
        """The next transition of a side; the items up to it go into the part."""
        into = self._part.plant if side == "plant" else self._part.controller
        for item in self._items.get(side, ()):
            into.append(item)
            if side == "plant":
                self._file(item)
            if isinstance(item, Walked):
                return item
        return None

    def _file(self, item: Item) -> None:
        if isinstance(item, Walked):
            if self._plant is not None and self._plant.t.session != item.t.session:
                self._over.add(self._plant.t.session)
            self._e.steps.counted(item.t, item.carry.pad)
        elif isinstance(item, MissedLine):
            self._e.steps.missed(item)


def read_evidence(run_dir: Path) -> Evidence:
    """Open a run's folder.

    Raises
    ------
    FileNotFoundError
        When there is no run: no scenario, or neither end's trace.
    protocol.scenario.ScenarioError, OSError
        When one of them cannot be read.
    runtime.errors.UsageError
        When the run goes on: what one end has written, the other may not have yet.
    """
    refuse_running(run_dir)
    if not (run_dir / SCENARIO).is_file():
        raise FileNotFoundError(f"{run_dir}: no run here, expected {SCENARIO}")
    run = Run.load(run_dir)
    rules = rules_of(run.scenario)
    journals = {"plant": read_plant(run_dir, rules), "controller": read_controller(run_dir, rules)}
    readers: dict[str, SideReader] = {}
    for side in TRACES:
        if parts_of(run.trace(side)):
            kept = journals[side]
            journal = kept if isinstance(kept, JournalState) else None
            readers[side] = SideReader(side, run.trace(side), rules, journal)
    if not readers:
        raise FileNotFoundError(
            f"{run_dir}: no run here, expected {PLANT_TRACE} or {CONTROLLER_TRACE}"
        )
    wire = CaptureLines(run_dir / CAPTURE)
    return Evidence(
        run=run,
        rules=rules,
        plant=readers.get("plant"),
        controller=readers.get("controller"),
        plant_journal=journals["plant"],
        controller_journal=journals["controller"],
        wire=wire if wire else None,
    )
