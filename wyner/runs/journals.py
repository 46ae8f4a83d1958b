"""What the journals of a run say: how far each end had come, and the step that it had not traced.

They are read from a copy, so that a run's folder stays as it was found, and one that is still held
by a process is not disturbed.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.agreement import NO_SYMBOL
from protocol.link.incoming import Incoming
from protocol.link.records import ControllerRecord, LinkRecord, PlantRecord
from protocol.link.session import CountedTransition, Rules, reports
from protocol.link.step import Answered, Read
from protocol.messages import Measurement, Offer
from protocol.schemes.base import decrypt
from protocol.schemes.framing import frame_length
from protocol.secret.nonces import contribution_of
from protocol.secret.stream import Held, KeyStream
from protocol.vectors import Vector
from runtime.journal import ControllerJournal, JournalError, PlantJournal
from runtime.run_folder import CONTROLLER_JOURNAL, PLANT_JOURNAL


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
            loaded = journal.load()
            record, step, t = loaded.record or ControllerRecord(), loaded.step, None
            if isinstance(step, Answered) and reports(record.link, record.offer, step.measurement):
                t = _by_controller(rules, record, step.measurement, loaded.held)
            delivered = record.frame.message + (t is not None and _ends_frame(t, record, journal))
            for number in range(delivered, journal.queued):
                journal.identifier(number)  # one that is missing is named
            if delivered > journal.queued:
                raise JournalError(
                    f"{delivered} messages were delivered, and {journal.queued} queued"
                )
            return JournalState(
                session=record.session.id,
                transitions=record.link.transitions + (t is not None),
                pending=None if t is None else t.as_event(),
                s=rules.scheme.restore(record.link.state)[0] if t is None else t.s,
                messages=journal.queued,
                newest=journal.identifier(journal.queued - 1) if journal.queued else "",
                delivered=delivered,
                waiting=tuple((i, text) for n, i, text in journal.waiting() if n >= delivered),
            )

    return _from_copy(run_dir / CONTROLLER_JOURNAL, read)


def read_plant(run_dir: Path, rules: Rules) -> JournalState | str | None:
    """The plant's journal, in the same way."""

    def read(path: Path) -> JournalState | None:
        with PlantJournal(path, rules.fingerprint) as journal:
            loaded, last = journal.load(), journal.last_message()
        record, t, received = loaded.record, None, None
        if record is None:
            return None
        if isinstance(loaded.step, Read):
            t = _by_plant(rules, record, loaded.step, loaded.held)
            if t.message_symbol != NO_SYMBOL:
                under_way = Incoming(rules.size, record.frame, loaded.symbols)
                received = under_way.deframer.push(t.message_symbol)
        return JournalState(
            session=record.session.id,
            transitions=record.link.transitions + (t is not None),
            pending=None if t is None else t.as_event(),
            s=rules.scheme.restore(record.link.state)[0] if t is None else t.s,
            messages=record.frame.messages + (received is not None),
            last=last if received is None else received,
            k=record.link.k + (t is not None),
            x=record.link.x if t is None else t.x_next,
        )

    return _from_copy(run_dir / PLANT_JOURNAL, read)


def _by_controller(
    rules: Rules,
    record: ControllerRecord,
    answered: Measurement,
    held: Held,
) -> CountedTransition:
    """The transition that the measurement it has answered reports."""
    offer = record.offer
    assert offer is not None
    digits = _digits(rules, offer, answered, held)
    t = _counted(rules, record.link, offer, answered.x_after, digits, answered.applied_copy)
    carried = t.role == "message"
    expected = digits[0] if digits and rules.keyed else NO_SYMBOL
    return t._replace(
        message_symbol=record.frame.message_symbol if carried else NO_SYMBOL, expected=expected
    )


def _by_plant(
    rules: Rules,
    record: PlantRecord,
    step: Read,
    held: Held,
) -> CountedTransition:
    """The transition that it has saved, with what it will report of it."""
    offer, coin, report = step
    digits = _digits(rules, offer, report, held)
    t = _counted(rules, record.link, offer, report.x, digits, offer.copy_number, coin)
    symbol = NO_SYMBOL if t.role == "test" else decrypt(offer.cipher, t.key, rules.size)
    return t._replace(message_symbol=symbol, coin=coin, u=offer.candidates[coin])


def _digits(rules: Rules, offer: Offer, said: Measurement, held: Held) -> tuple[int, ...]:
    """The digits of the key stream that have served, as far as they are held."""
    if not said.keyed:
        return ()
    return KeyStream(rules.size, held).at(offer.position, rules.digits) or ()


def _counted(
    rules: Rules,
    link: LinkRecord,
    offer: Offer,
    x_next: Vector,
    digits: tuple[int, ...],
    copy: int,
    coin: int = NO_SYMBOL,
) -> CountedTransition:
    """What the pure functions make of an applied offer."""
    link = link._replace(state=rules.scheme.restore(link.state))
    counted = rules.count(link, offer, x_next, digits, coin)
    row = None
    if rules.schedule is not None and link.transitions:
        row = contribution_of(
            j=link.transitions,
            steps=offer.k - link.applied_k,
            offer=offer.nonce,
            applied_copy=copy,
            measurement=link.nonce,
            heard=offer.heard,
        )
    return CountedTransition.of(rules.scheme, link, offer, x_next, counted, NO_SYMBOL, row)


def _ends_frame(t: CountedTransition, record: ControllerRecord, journal: ControllerJournal) -> bool:
    """Whether a transition carried the last symbol of a frame."""
    if t.role == "test" or not record.frame.framed:
        return False
    payload = journal.payload(record.frame.message)
    return payload is not None and record.frame.offset == frame_length(
        len(payload), len(t.candidates)
    )


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
