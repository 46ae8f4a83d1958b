"""What a check is, what it counts, and what checks share."""

from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from protocol.brief import Brief
from wyner.runs.check.evidence import Evidence, Part

EDGE: Final = 1e-9
"""A gauge or a constraint beyond its bound by less than this is on the bound: rounding."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a check did not hold; -1 or empty where a number does not apply."""

    session: str
    j: int
    k: int
    text: str


@dataclass(slots=True)
class Counter:
    """What a check counted and found; ``skipped`` says why there was nothing to look at."""

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


class Check:
    """One thing that the paper or the protocol demands of a run.

    It is fed a run's parts in order, and told when there are no more.

    Attributes
    ----------
    name : str
    source : str
        The paper's equation or figure, or the rule of docs/protocol.md.
    says : str
        What must hold, in one line.
    of : str
        What is counted.
    needs : tuple of str
        Fields of the evidence without which there is nothing to look at.

    Parameters
    ----------
    evidence : Evidence
    counter : Counter
        Is filled.
    """

    name: ClassVar[str]
    source: ClassVar[str]
    says: ClassVar[str]
    of: ClassVar[str]
    needs: ClassVar[tuple[Literal["plant", "controller", "wire"], ...]] = ()

    def __init__(self, evidence: Evidence, counter: Counter) -> None:
        self.evidence, self.counter = evidence, counter

    @classmethod
    def skipped(cls, evidence: Evidence) -> str:
        """Why there is nothing to look at; empty where there is."""
        missing = [_CALLED[name] for name in cls.needs if getattr(evidence, name) is None]
        return f"no {' and no '.join(missing)} in this run's folder" if missing else ""

    def feed(self, part: Part) -> None:
        """Look at the next part of the run."""

    def finish(self) -> None:
        """There are no more parts."""


_CALLED: Final = {
    "plant": "plant trace",
    "controller": "controller trace",
    "wire": "capture",
}


@dataclass(frozen=True, slots=True, repr=False)
class Result(Brief):
    """A check and how it came out."""

    check: type[Check]
    counter: Counter

    def brief(self) -> dict[str, object]:
        """What was looked at, how it came out, and the first place where it does not hold."""
        c = self.counter
        told = {"check": self.check.name, "result": self.result, self.check.of: c.counted}
        return told if c.first is None else told | {"first": c.first.text}

    @property
    def result(self) -> Literal["PASS", "FAIL", "SKIP"]:
        """SKIP where the run left nothing to look at."""
        if self.counter.failures:
            return "FAIL"
        return "SKIP" if self.counter.skipped or not self.counter.counted else "PASS"

    def as_json(self) -> dict[str, Any]:
        """The result for machines."""
        c, first = self.counter, self.counter.first
        return {
            "name": self.check.name,
            "source": self.check.source,
            "says": self.check.says,
            "result": self.result,
            "counted": c.counted,
            "of": self.check.of,
            "failures": c.failures,
            "first": None
            if first is None
            else {"session": first.session, "j": first.j, "k": first.k, "text": first.text},
            "note": c.skipped or c.note,
        }


def may_leave(e: Evidence) -> bool:
    """Whether the scenario says that d(k) may leave D_c."""
    d = e.scenario.plant.disturbance
    return d.may_leave_defender_set or d.kind == "gaussian"
