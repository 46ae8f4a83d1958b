"""What an end has of its status beside its state, and when it is published."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import inf
from typing import Any, Literal

from protocol.link.effects import Notice
from protocol.link.pacing import HEALTH_S, next_turn, phase_of
from protocol.link.session import CountedTransition
from protocol.link.state import EndState
from protocol.messages import Message, Status

Phase = Literal["greeting", "running", "outside", "alarmed", "stopped", "refused"]


class Telemetry(ABC):
    """Base of both ends'.

    Parameters
    ----------
    status_s : float, optional
        Seconds between two statuses; None: none is published.

    Attributes
    ----------
    phase, detail : str
        What the end is doing, and why it does no more.
    due_at, health_at : float
        When the next status is due, and the next that is kept in the run's folder.
    """

    def __init__(self, status_s: float | None) -> None:
        self.status_s = status_s
        self.phase: Any = "greeting"  # a status states which its end has
        self.detail = ""
        self.due_at = inf
        self.health_at = -inf
        self._seq = self._unexplained = 0

    def counted(self, t: CountedTransition) -> str | None:
        """Take in a transition; what is to be warned of, if anything."""
        self._unexplained += t.verdict.unexplained
        return None

    def enter(self, phase: Phase, detail: str | None = None) -> None:
        """The end is in another phase; None: the detail stays."""
        self.phase = phase
        if detail is not None:
            self.detail = detail

    def stop(self) -> None:
        """The end stops; one that was refused shows that."""
        if self.phase != "refused":
            self.phase = "stopped"

    def refusal(self, text: str) -> Notice:
        """Why the end does no more for now: the detail, and a line for the log."""
        self.detail = text
        return Notice(text, "warning", "refusals")

    def soon(self, now: float) -> None:
        """Have a status published and kept at the next wake, which is then due at once."""
        if self.status_s is not None:
            self.due_at = self.health_at = now

    def is_due(self, now: float, instance: str) -> bool:
        """Whether to publish a status now; if so, the next one is due later."""
        if self.status_s is None or now < self.due_at:
            return False
        self.due_at = next_turn(now, self.status_s, phase_of(instance))
        return True

    def health_is_due(self, now: float) -> bool:
        """Whether a status is to be kept in the run's folder: once in :data:`HEALTH_S`."""
        due = now >= self.health_at
        if due:
            self.health_at = now + HEALTH_S
        return due

    def common(self, state: EndState, malformed: int, t_ns: int) -> dict[str, Any]:
        """The fields of a status that both ends have alike, but for the step."""
        self._seq += 1
        return {
            "seq": self._seq,
            "t_ns": t_ns,
            "phase": self.phase,
            "detail": self.detail,
            "malformed": malformed,
            "session": state.record.session.id,
            "keys": state.keys.status(),
        }

    def step(self, state: EndState) -> dict[str, Any]:
        """The fields of a step that both ends have alike.

        Where outputs are read the state is as it was estimated after the last offer.
        """
        link, x = state.link, state.link.x
        if state.rules.outputs is not None:
            states = (0.0,) * len(state.rules.agreement.A)
            x = states if link.estimate is None else link.estimate.box.centre
        return {
            "k": link.k,
            "x": x,
            "transitions": link.transitions,
            "agreements": link.agreements,
            "symbols": link.p,
            "automaton": link.s,
            "unexplained": self._unexplained,
        }

    @abstractmethod
    def status(self, state: Any, malformed: int) -> Status:
        """What the dashboard is told of an end's state."""

    def messages(self, state: Any, malformed: int) -> Sequence[Message]:
        """What is published when a status is due; the status is the last."""
        return (self.status(state, malformed),)
