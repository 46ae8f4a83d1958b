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
from protocol.link.pacing import Pacing
from protocol.link.session import CountedTransition, Rules, Truth
from protocol.vectors import Vector
from runtime.chance import SystemSymbols
from runtime.journal import ControllerJournal, PlantJournal
from runtime.journal_files import JournalError
from runtime.run_folder import CONTROLLER_JOURNAL, PLANT_JOURNAL
from runtime.step_log import STEPS

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
    messages : tuple of (str, bytes)
        The controller's queue, or what the plant has received (without identifiers).
    k : int
        Step that the plant has come to.
    x : tuple of float
        Its state there.
    """

    session: str | None
    transitions: int
    pending: dict[str, Any] | None
    s: int
    messages: tuple[tuple[str, bytes], ...]
    k: int = -1
    x: tuple[float, ...] = ()


def read_controller(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The controller's journal; or what is wrong with it; None where there is none."""

    def read(path: Path) -> JournalState:
        with ControllerJournal(path, rules.fingerprint) as journal:
            messages = tuple(
                (journal.identifier(number), journal.payload(number) or b"")
                for number in range(journal.queued)
            )
            record = journal.load()
            contributions = journal.contributions(None if record is None else record.session)
            core = ControllerCore(
                rules,
                _propose_nothing,
                journal,
                SystemSymbols(),
                instance=INSTANCE,
                period_s=1.0,
                record=record,
                measurement=journal.measurement,
                offer=journal.offer,
                contributions=contributions,
            )
            pending = None
            if core.unfinished:
                for event in core.finish_step().events:
                    if isinstance(event, CountedTransition):
                        pending = event.as_event()
            record = core.record
        return JournalState(
            session=record.session,
            transitions=record.transitions,
            pending=pending,
            s=record.s,
            messages=messages,
        )

    return _from_copy(run_dir / CONTROLLER_JOURNAL, read)


def read_plant(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The plant's journal, in the same way."""

    def read(path: Path) -> JournalState | None:
        with PlantJournal(path, rules.fingerprint) as journal:
            record = journal.load()
            if record is None:
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
                record=record,
                chunks=journal.chunks(),
                contributions=journal.contributions(record.session),
                offer=journal.offer,
                tossed=journal.coin,
                report=journal.measurement,
            )
            messages = tuple(("", payload) for payload in journal.inbox(-1))
        pending = None
        if core.start(0.0).finish_step:
            counted = [e for e in core.finish_step().events if isinstance(e, CountedTransition)]
            pending = counted[0].as_event()
        record = core.record
        return JournalState(
            session=record.session,
            transitions=record.transitions,
            pending=pending,
            s=record.s,
            messages=messages,
            k=record.k,
            x=record.x,
        )

    return _from_copy(run_dir / PLANT_JOURNAL, read)


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
            # Steps first: those that a process has since put into its database are then left out.
            for suffix in (STEPS, "", "-wal"):
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
