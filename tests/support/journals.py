"""Journals of ends that are driven by hand, and what is in them."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from protocol.messages import SendCommand
from runtime.journal import ControllerJournal, PlantJournal

SCENARIO = "f" * 64


def plant_journal() -> PlantJournal:
    """A plant's in memory; it outlives the ends that write it."""
    return PlantJournal(None, SCENARIO)


def controller_journal(*payloads: bytes) -> ControllerJournal:
    """A controller's in memory, with messages to deliver."""
    return handed_over(ControllerJournal(None, SCENARIO), payloads)


def handed_over(journal: ControllerJournal, payloads: Sequence[bytes]) -> ControllerJournal:
    """The journal, with messages in its queue."""
    for payload in payloads:
        journal.enqueue(SendCommand(id=f"{journal.queued}", payload=payload))
    return journal


def copied(journal: Path, folder: Path) -> Path:
    """A copy of a journal's files, as a death leaves them."""
    folder.mkdir()
    for path in journal.parent.glob(f"{journal.name}*"):
        shutil.copyfile(path, folder / path.name)
    return folder / journal.name


def contents(journal: ControllerJournal | PlantJournal) -> tuple[tuple[Any, ...], ...]:
    """All rows of a journal, table by table."""
    db = journal.db
    names = [table.split()[0] for table in journal.tables]
    return tuple([tuple(db.execute(f"SELECT * FROM {name}")) for name in names])


def fill(
    journal: ControllerJournal | PlantJournal, rows: tuple[tuple[Any, ...], ...]
) -> ControllerJournal | PlantJournal:
    """A journal with these rows in the place of its own."""
    journal.forget()
    for table, some in zip(journal.tables, rows, strict=True):
        if some:
            marks = ", ".join("?" * len(some[0]))
            journal.db.executemany(f"INSERT INTO {table.split()[0]} VALUES ({marks})", some)
    journal.load()
    return journal
