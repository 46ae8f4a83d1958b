"""What the journals of a run say: how far each end had come, and the step that it had not traced.

They are read from a copy, so that a run's folder stays as it was found, and one that is still held
by a process is not disturbed.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from protocol.link.records import ControllerRecord
from protocol.link.session import Rules, reports
from protocol.link.step import Answered, Read
from runtime.journal import ControllerJournal, JournalError, PlantJournal
from runtime.run_folder import CONTROLLER_JOURNAL, PLANT_JOURNAL


@dataclass(frozen=True, slots=True)
class JournalState:
    """One end's journal.

    Parameters
    ----------
    session : str or None
    transitions : int
        That it has counted of that session.
    ahead : int
        The step of the transition that it has saved and will count next; -1 none. Its trace may
        not have it yet.
    s : int
        The automaton's state after those that are counted.
    messages : int
        How many were queued at the controller, or received at the plant, since this journal began.
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
    ahead: int
    s: int
    messages: int
    waiting: tuple[tuple[str, bytes], ...] = ()
    last: bytes | None = None
    newest: str = ""
    k: int = -1
    x: tuple[float, ...] = ()


def read_controller(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The controller's journal; or what is wrong with it; None where there is none."""

    def read(path: Path) -> JournalState:
        with ControllerJournal(path, rules.fingerprint) as journal:
            loaded = journal.load()
            record, step = loaded.record or ControllerRecord(), loaded.step
            offer = record.offer if isinstance(step, Answered) else None
            counts = isinstance(step, Answered) and reports(record.link, offer, step.measurement)
            delivered = record.frame.message
            for number in range(delivered, journal.queued):
                journal.identifier(number)  # one that is missing is named
            if delivered > journal.queued:
                raise JournalError(
                    f"{delivered} messages were delivered, and {journal.queued} queued"
                )
            return JournalState(
                session=record.session.id,
                transitions=record.link.transitions,
                ahead=offer.k if offer is not None and counts else -1,
                s=rules.scheme.restore(record.link.state)[0],
                messages=journal.queued,
                newest=journal.identifier(journal.queued - 1) if journal.queued else "",
                waiting=tuple((i, text) for n, i, text in journal.waiting() if n >= delivered),
            )

    return _from_copy(run_dir / CONTROLLER_JOURNAL, read)


def read_plant(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The plant's journal, in the same way."""

    def read(path: Path) -> JournalState | None:
        with PlantJournal(path, rules.fingerprint) as journal:
            loaded, last = journal.load(), journal.last_message()
        record = loaded.record
        if record is None:
            return None
        return JournalState(
            session=record.session.id,
            transitions=record.link.transitions,
            ahead=record.link.k if isinstance(loaded.step, Read) else -1,
            s=rules.scheme.restore(record.link.state)[0],
            messages=record.frame.messages,
            last=last,
            k=record.link.k,
            x=record.link.x,
        )

    return _from_copy(run_dir / PLANT_JOURNAL, read)


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
