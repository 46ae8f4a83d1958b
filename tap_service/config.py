"""All that a tap is told: what she knows, what she sees, where it is kept."""

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field as default
from pathlib import Path
from typing import Any, Final

from protocol.knowledge import Knowledge
from protocol.topics import DEFAULT_LOOP
from runtime.recording import Bounds
from tap_service.capture.channel import View
from tap_service.eavesdroppers import DEFAULT, LADDER, ORACLE, KnowledgeError, named

SILENT_S: Final = 20.0
"""Seconds of silence after which the tap's session is opened again: later than those of the ends,
for a loop that pauses is no fault of the tap's, and what is said meanwhile would be missed."""

FINISH_S: Final = 20.0
"""Time the heavy eavesdroppers get, at the end, for what they have not read yet."""


@dataclass(frozen=True, slots=True)
class TapConfig:
    """All that the tap is told.

    Parameters
    ----------
    run_dir : Path
        Everything is written below its folder ``tap``.
    knowledge : Knowledge
        What every eavesdropper but the oracle knows.
    oracle_knowledge : Knowledge, optional
        The oracle's; without it there can be none.
    names : tuple of str
        Eavesdroppers, by name or as ``FILE.py:NAME``.
    view : View
        What the tap sees, and how well.
    loop : str
    limits : Bounds
        Of the capture; the logs of guesses get an eighth of it each.
    finish_s : float
        Seconds that the heavy eavesdroppers have for their last thoughts.
    """

    run_dir: Path
    knowledge: Knowledge
    oracle_knowledge: Knowledge | None = None
    names: tuple[str, ...] = DEFAULT
    view: View = default(default_factory=View)
    loop: str = DEFAULT_LOOP
    limits: Bounds = default(default_factory=Bounds)
    finish_s: float = FINISH_S

    def knowledge_of(self, name: str) -> Knowledge:
        """What the eavesdropper ``name`` is told; the oracle's model has no error."""
        if name == ORACLE:
            if self.oracle_knowledge is None:
                raise KnowledgeError(f"{ORACLE}: expected a scenario, which has alpha")
            return self.oracle_knowledge
        return self.view.knowledge(self.knowledge, model=named(name).told_model)

    def header(self) -> dict[str, Any]:
        """The public part of what a recording's header says."""
        from importlib.metadata import version

        return {
            "loop": self.loop,
            "knowledge": self.knowledge.model_dump(mode="json"),
            "view": self.view.model_dump(mode="json"),
            "eavesdroppers": self.names,
            "appearances": 1,  # of a message that reach her: she has one link to each end
            "wyner_version": version("wyner"),
        }


def runs_beside(name: str) -> bool:
    """Whether an eavesdropper runs beside the mirror: a heavy one, and each of a user's."""
    return name not in LADDER or named(name).heavy


def each_once(names: Iterable[str]) -> tuple[str, ...]:
    """The eavesdroppers without those that are named again.

    Raises
    ------
    KnowledgeError
        When two have one name: nobody could tell their guesses apart.
    """
    found: dict[str, str] = {}
    for name in names:
        its = named(name).name
        if found.setdefault(its, name) != name:
            raise KnowledgeError(f"{found[its]} and {name} are both named {its!r}")
    return tuple(dict.fromkeys(names))


def eighth(limits: Bounds) -> Bounds:
    """Bounds of a log of guesses, from the capture's."""
    return limits.model_copy(
        update={
            "part_bytes": max(limits.part_bytes // 8, 1024),
            "total_bytes": max(limits.total_bytes // 8, 2048),
        }
    )
