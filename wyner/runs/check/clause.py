"""What a clause is, what it counts, and what clauses share."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, Literal

from protocol.brief import Brief
from wyner.runs.check.evidence import Evidence, Part

EDGE: Final = 1e-9
"""A gauge or a constraint beyond its bound by less than this is on the bound: rounding."""

Judging = Generator[None, Part | None, None]
"""A clause at work: it is sent a run's parts in order, and None when there are no more."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a clause did not hold; -1 or empty where a number does not apply."""

    session: str
    j: int
    k: int
    text: str


@dataclass(slots=True)
class Tally:
    """What a clause counted and found; ``skipped`` says why there was nothing to look at."""

    counted: int = 0
    failures: int = 0
    first: Place | None = None
    note: str = ""
    skipped: str = ""

    def count(self, holds: bool, session: str, j: int, k: int, text: str = "") -> bool:
        """Count one more case; where it does not ``hold`` keep the first. Returns ``holds``."""
        self.counted += 1
        if not holds:
            self.fail(session, j, k, text)
        return holds

    def fail(self, session: str, j: int, k: int, text: str) -> None:
        """Something does not hold."""
        self.failures += 1
        if self.first is None:
            self.first = Place(session, j, k, text)


@dataclass(frozen=True, slots=True)
class Clause:
    """One thing that the paper or the protocol demands of a run.

    Parameters
    ----------
    name : str
    source : str
        The paper's equation or figure, or the rule of docs/protocol.md.
    says : str
        What must hold, in one line.
    of : str
        What is counted.
    judge : callable
        Given the evidence and a tally, a generator that fills the tally from the parts it is sent:
        ``while (part := (yield)) is not None``. One that has nothing to look at returns at once.
    """

    name: str
    source: str
    says: str
    of: str
    judge: Callable[[Evidence, Tally], Judging]


@dataclass(frozen=True, slots=True, repr=False)
class Finding(Brief):
    """A clause and how it came out."""

    clause: Clause
    tally: Tally

    def brief(self) -> dict[str, object]:
        """What was looked at, how it came out, and the first place where it does not hold."""
        t = self.tally
        told = {"clause": self.clause.name, "result": self.result, self.clause.of: t.counted}
        return told if t.first is None else told | {"first": t.first.text}

    @property
    def result(self) -> Literal["PASS", "FAIL", "SKIP"]:
        """SKIP where the run left nothing to look at."""
        if self.tally.failures:
            return "FAIL"
        return "SKIP" if self.tally.skipped or not self.tally.counted else "PASS"

    def as_json(self) -> dict[str, Any]:
        """The finding for machines."""
        t, first = self.tally, self.tally.first
        return {
            "name": self.clause.name,
            "source": self.clause.source,
            "says": self.clause.says,
            "result": self.result,
            "counted": t.counted,
            "of": self.clause.of,
            "failures": t.failures,
            "first": None
            if first is None
            else {"session": first.session, "j": first.j, "k": first.k, "text": first.text},
            "note": t.skipped or t.note,
        }


def to_the_end() -> Judging:
    """What a clause that looks at a run as a whole waits for."""
    while (yield) is not None:
        pass


def need(tally: Tally, **parts: object) -> bool:
    """Whether all parts are there; if not the clause is skipped."""
    missing = [name.replace("_", " ") for name, part in parts.items() if part is None]
    if missing:
        tally.skipped = f"no {' and no '.join(missing)} in this run's folder"
    return not missing


def may_leave(e: Evidence) -> bool:
    """Whether the scenario says that d(k) may leave D_c."""
    d = e.scenario.plant.disturbance
    return d.may_leave_defender_set or d.kind == "gaussian"
