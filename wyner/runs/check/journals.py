"""What the journals of a run say: how far each end had come, and the step that it had not traced.

They are read from a copy, so that a run's folder stays as it was found, and one that is still held
by a process is not disturbed.
"""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from plant_service.plant import Coin
from protocol.link.effects import Effects, Save, Tell
from protocol.link.pacing import Pacing
from protocol.link.session import CountedTransition, Rules, Truth
from protocol.vectors import Vector
from runtime.chance import SystemSymbols
from runtime.journal import ControllerJournal, JournalError, PlantJournal
from runtime.run_folder import CONTROLLER_JOURNAL, PLANT_JOURNAL

INSTANCE: Final = "0" * 16


@dataclass(frozen=True, slots=True)
class JournalState:
    """One end's journal.

    Parameters
    ----------
    session : str or None
    transitions : int
        Of that session, the pending one included.
    pending : dict, optional
        The transition that follows the record, as a trace's event.
    s : int
        The automaton's state after it.
    messages : int
        How many were queued at the controller, or received at the plant, since this journal began.
    delivered : int
        Of the controller's queue.
    waiting : tuple of (str, bytes)
        Identifier and text of the messages that the controller has still to deliver.
    last : bytes, optional
        The message that the plant received last.
    newest : str
        Identifier of the message that was queued last.
    k : int
        Step that the plant has come to.
    x : tuple of float
        Its state there.
    """

    session: str | None
    transitions: int
    pending: dict[str, Any] | None
    s: int
    messages: int
    delivered: int = 0
    waiting: tuple[tuple[str, bytes], ...] = ()
    last: bytes | None = None
    newest: str = ""
    k: int = -1
    x: tuple[float, ...] = ()


def read_controller(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The controller's journal; or what is wrong with it; None where there is none."""

    def read(path: Path) -> JournalState:
        with ControllerJournal(path, rules.fingerprint) as journal:
            core = ControllerCore(
                rules,
                _propose_nothing,
                journal,
                SystemSymbols(),
                instance=INSTANCE,
                period_s=1.0,
                loaded=journal.load()._replace(fell_back=False),
            )
            pending, _ = _counted(core.start(0.0))
            record = core.record
            for number in range(record.message, journal.queued):
                journal.identifier(number)  # one that is missing is named
            if record.message > journal.queued:
                raise JournalError(
                    f"{record.message} messages were delivered, and {journal.queued} queued"
                )
            return JournalState(
                session=record.session,
                transitions=record.transitions,
                pending=pending,
                s=record.s,
                messages=journal.queued,
                newest=journal.identifier(journal.queued - 1) if journal.queued else "",
                delivered=record.message,
                waiting=tuple(
                    (identifier, payload)
                    for number, identifier, payload in journal.waiting()
                    if number >= record.message
                ),
            )

    return _from_copy(run_dir / CONTROLLER_JOURNAL, read)


def read_plant(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The plant's journal, in the same way."""

    def read(path: Path) -> JournalState | None:
        with PlantJournal(path, rules.fingerprint) as journal:
            loaded, last = journal.load(), journal.last_message()
            if loaded.record is None:
                return None
            core = PlantCore(
                rules,
                _Unmoved(),
                Coin(SystemSymbols(), rules.size),
                _fall_back_on_nothing,
                Pacing(None, 1, 0.0),
                lambda: INSTANCE,
                0.0,
                instance=INSTANCE,
                loaded=loaded._replace(fell_back=False),
            )
        pending, received = _counted(core.start(0.0))
        record = core.record
        return JournalState(
            session=record.session,
            transitions=record.transitions,
            pending=pending,
            s=record.s,
            messages=record.messages,
            last=last if received is None else received,
            k=record.k,
            x=record.x,
        )

    return _from_copy(run_dir / PLANT_JOURNAL, read)


def _counted(effects: Effects) -> tuple[dict[str, Any] | None, bytes | None]:
    """The transition that a journal left to be counted, and the message that it brought."""
    pending, received = None, None
    for effect in effects:
        if isinstance(effect, Tell) and isinstance(effect.event, CountedTransition):
            pending = effect.event.as_event()
        elif isinstance(effect, Save) and effect.received is not None:
            received = effect.received
    return pending, received


class _Unmoved:
    """The plant of a journal that is read: nothing moves it."""

    acts = device = False
    truth: Truth | None = None

    def prepare(self, k: int) -> None:
        """No step comes."""

    def begin(self, k: int, x: Vector, u: Vector) -> None:  # noqa: ARG002
        """Nobody asks for a step."""
        raise AssertionError("a journal that is read makes no step")

    def end(self, k: int) -> Vector:  # noqa: ARG002
        """Nobody asks for a step."""
        raise AssertionError("a journal that is read makes no step")

    def safe(self, why: str) -> None:
        """Nothing moves."""

    def close(self) -> str:
        """Nothing is open."""
        return ""


def _fall_back_on_nothing(_x: Vector, in_force: Vector) -> Vector:
    return in_force


def _propose_nothing(_x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    raise LookupError("a journal that is read offers nothing")


def _from_copy(
    path: Path, read: Callable[[Path], JournalState | None]
) -> JournalState | str | None:
    if not path.is_file():
        return None
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        try:
            for suffix in ("", "-wal"):
                source = path.with_name(path.name + suffix)
                if source.is_file():
                    shutil.copyfile(source, copy.with_name(copy.name + suffix))
            return read(copy)
        except JournalError as error:
            return str(error).removeprefix(f"{copy}: ").removeprefix(f"{folder}/")
        except OSError as error:
            return f"cannot be read: {error.strerror}"
        except (AssertionError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            return f"its step does not follow from its record: {type(error).__name__}: {error}"
