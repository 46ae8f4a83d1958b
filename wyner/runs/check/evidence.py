"""What a run left behind, opened for checking; nothing here judges."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path
from typing import Any, Final

from protocol.brief import Brief
from protocol.link.records import Side
from protocol.link.session import Rules, rules_of
from protocol.scenario import Scenario
from runtime.locks import refuse_running
from runtime.recording import parts_of
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE, SCENARIO
from wyner.runs.heard import CaptureLines
from wyner.runs.journals import JournalState, read_controller, read_plant
from wyner.runs.lines import TracedTransition
from wyner.runs.run import TRACES, Run
from wyner.runs.trace import Rows, Trace

EDGE: Final = 1e-9
"""A gauge or a constraint beyond its bound by less than this is on the bound: rounding."""


@dataclass(frozen=True, slots=True, repr=False)
class Finding(Brief):
    """A place at which a run does not obey a rule.

    Parameters
    ----------
    rule : str
    session : str
        Empty where it is of none.
    k : int
        The step; -1 where it is of none.
    text : str
    """

    rule: str
    session: str
    k: int
    text: str

    def brief(self) -> dict[str, object]:
        """Its fields."""
        return asdict(self)

    def __str__(self) -> str:
        where = f"session {self.session}, " if self.session else ""
        where += f"step {self.k}, " if self.k >= 0 else ""
        return f"{self.rule}: {where}{self.text}"


Findings = Iterator[Finding]


class Evidence:
    """Everything that a rule looks at; what a run did not leave is None.

    A journal is a string where it cannot be read: why.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.folder: Path = run.folder
        self.scenario: Scenario = run.scenario
        self.rules: Rules = rules_of(run.scenario)
        self.journals: dict[Side, JournalState | str | None] = {
            "plant": read_plant(run.folder, self.rules),
            "controller": read_controller(run.folder, self.rules),
        }
        self.plant, self.controller = self._trace("plant"), self._trace("controller")
        wire = CaptureLines(run.folder / CAPTURE)
        self.capture = wire if wire else None

    def _trace(self, side: Side) -> Trace | None:
        if not parts_of(self.run.trace(side)):
            return None
        trace, journal = self.run.read(side), self.journals[side]
        if isinstance(journal, JournalState) and journal.session is not None and not trace.ended:
            at, last = (journal.session, journal.ahead), trace.last
            traced = last is not None and (last.session, last.k) == at
            trace.untraced = None if traced or journal.ahead < 0 else at
        return trace

    def ends(self) -> Iterator[Trace]:
        """Both ends' traces, as far as they are there."""
        yield from (trace for trace in (self.plant, self.controller) if trace is not None)

    @property
    def cut(self) -> str:
        """Which parts of the traces are gone, and what is judged of the rest; empty: none are."""
        return "; ".join(
            f"parts 0 to {t.gone - 1} of the {t.side}'s trace are gone, "
            + (f"judged after transition {t.cut.j}" if t.cut else "nothing left can be judged")
            for t in self.ends()
            if t.gone
        )

    @property
    def may_leave(self) -> bool:
        """Whether the scenario says that d(k) may leave D_c."""
        d = self.scenario.plant.disturbance
        return d.may_leave_defender_set or d.kind == "gaussian"

    def lies(self, k: Any) -> Any:
        """Whether what is said of step k, or of its end, need not be the truth of the plant."""
        return k + 1 >= self._onset(bus=False)

    def rewrites(self, k: Any) -> Any:
        """Whether the two ends need not have the same numbers of step k."""
        return k + 1 >= self._onset(bus=True)

    def _onset(self, *, bus: bool) -> float:
        """The step from which on an attack on the bus, or on the plant, is under way."""
        attack = None if self.plant is None else self.plant.attack
        return inf if attack is None or (attack.at == "bus") != bus else attack.onset


def before(trace: Trace) -> TracedTransition | None:
    """The transition that the first rows of a cut trace go on from, in one session."""
    cut = trace.cut
    return cut if cut is not None and trace.sessions[:1] == [cut.session] else None


def columns(rows: Rows, *names: str) -> list[list[Any]]:
    """Columns of a trace's rows as plain values."""
    return [rows[name].tolist() for name in names]


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
    if not any(parts_of(run.trace(side)) for side in TRACES):
        raise FileNotFoundError(
            f"{run_dir}: no run here, expected {PLANT_TRACE} or {CONTROLLER_TRACE}"
        )
    return Evidence(run)
