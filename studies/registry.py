"""The one registry: a study is a function from a task to rows, a table one from rows to text.

One runner measures what a data file lacks, in as many processes as it is given; one writer puts the
tables on their pages. A row has the id of its task and the hash of the code that made it: a row of
other code than today's is stale, and is measured again where it is asked for. Each page names the
code of the rows that it quotes, and says where they are stale.
"""

import csv
import hashlib
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

from protocol.statistics import Interval
from runtime.files import PUBLIC_FILE, write_atomically
from runtime.progress import shown
from studies import DATA
from wyner.sweeps.code import ROOT, code_version, same_code
from wyner.sweeps.results import read_table
from wyner.sweeps.workers import SerialExecutor, in_order

Row = dict[str, str]
Lines = Sequence[Sequence[str]]
Values = Sequence[Any] | Mapping[str, Any]
Measure = Callable[[Any], Iterable[Values]]

MODULES: Final = (
    "attacks.study", "attacks.tables", "capacity", "corners", "eavesdroppers", "keys",
    "loops", "missed_steps", "network", "noise", "other_sets", "outputs", "readings",
    "schemes", "secrecy.kinds", "secrecy.study", "secrecy.tables", "settled",
    "shape", "signalling", "stochastic", "sweeps", "yardstick",
)  # fmt: skip
"""Where studies and tables are."""


@dataclass(frozen=True)
class Study:
    """What is measured into one file of docs/data.

    Parameters
    ----------
    name : str
        Of the file, without its ending.
    columns : tuple of str
        Besides ``task`` and ``version``.
    tasks : callable
        Gives the tasks; any value that can travel to another process.
    rows : callable
        The rows of a task, as values in the order of the columns, or by column.
    module : str
        Whose code the rows come from.
    """

    name: str
    columns: tuple[str, ...]
    tasks: Callable[[], Iterable[Any]]
    rows: Measure
    module: str

    @property
    def version(self) -> str:
        """Of today's code."""
        return code_version(self.module)

    def id(self, task: Any) -> str:
        """A hash of what is measured and how."""
        named = getattr(task, "id", None)
        return named or hashlib.sha256(f"{self.name} {task!r}".encode()).hexdigest()[:12]

    def measured(self, task: Any) -> list[Row]:
        """The rows of a task, whole."""
        begin = {"task": self.id(task), "version": self.version}
        return [begin | self._by_column(row) for row in self.rows(task)]

    def _by_column(self, row: Values) -> Row:
        values = [row[column] for column in self.columns] if isinstance(row, Mapping) else list(row)
        texts = ["" if value is None else str(value) for value in values]
        return dict(zip(self.columns, texts, strict=True))

    def measure(
        self,
        path: Path,
        executor: Executor | None = None,
        only: str = "",
    ) -> None:
        """Add what a file lacks, or has of other code; each task's rows as they are made.

        Parameters
        ----------
        path : Path
            A CSV file; a task that a kill has torn is measured again.
        executor : Executor, optional
            Of :func:`wyner.sweeps.workers.workers`; this process by default.
        only : str
            Tasks whose text contains this.
        """
        wanted = {self.id(task): task for task in self.tasks() if only in str(task)}
        kept = [
            row
            for row in _whole_rows(path, self.head)
            if row["task"] not in wanted or same_code(row["version"], self.version)
        ]
        done = {row["task"] for row in kept}
        todo = [task for id, task in wanted.items() if id not in done]
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, self.head, kept)
        with (
            path.open("a", encoding="utf-8", newline="") as file,
            shown(f"{self.name}, tasks") as advance,
        ):
            advance(0, len(todo))
            work = self.measured if executor is None else partial(_measured, self.name)
            made = in_order(executor or SerialExecutor(), work, todo, lambda task: (task,))
            for number, (_, rows) in enumerate(made, 1):
                file.write(_text(self.head, rows))
                file.flush()
                advance(number, len(todo))
        order = {id: place for place, id in enumerate(wanted)}
        rows = sorted(_whole_rows(path, self.head), key=lambda row: order.get(row["task"], -1))
        _write(path, self.head, rows)

    @property
    def head(self) -> tuple[str, ...]:
        """All columns of the file."""
        return ("task", "version", *self.columns)


def _measured(name: str, task: Any) -> list[Row]:
    """In a process of a pool."""
    return studies()[name].measured(task)


def _text(head: Sequence[str], rows: Sequence[Row]) -> str:
    text = io.StringIO()
    csv.DictWriter(text, head, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _write(path: Path, head: Sequence[str], rows: Sequence[Row]) -> None:
    """The whole file, in place of the one before."""
    text = ",".join(head) + "\n" + _text(head, rows)
    write_atomically(path, text.encode(), PUBLIC_FILE)


def _whole_rows(path: Path, head: Sequence[str]) -> list[Row]:
    """The rows of whole tasks; none where the file has other columns."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole, _, torn = text.rpartition("\n")
    reader = csv.DictReader(io.StringIO(whole))
    rows = list(reader)
    if tuple(reader.fieldnames or ()) != tuple(head):
        return []
    cut = rows[-1]["task"] if rows and torn and torn.startswith(rows[-1]["task"]) else ""
    return [row for row in rows if row["task"] != cut]


def recorded(name: str, data: Path = DATA) -> list[Row]:
    """The rows of a data file.

    Raises
    ------
    SweepError
        When there are none.
    """
    return read_table(data / f"{name}.csv")


_STUDIES: Final[dict[str, Study]] = {}


@dataclass(frozen=True)
class Table:
    """A text on a page of docs, between its marks.

    Parameters
    ----------
    page : str
    studies : tuple of str
        Whose rows it is made of.
    make : callable
        Takes the rows of each.
    """

    page: str
    studies: tuple[str, ...]
    make: Callable[..., str | Lines]


TABLES: Final[dict[str, Table]] = {}
"""The tables, by the name of their marks."""


def add(one: Study) -> None:
    """Register a study."""
    _STUDIES[one.name] = one


Function = TypeVar("Function", bound=Callable[..., Any])


def study(
    name: str, columns: str, tasks: Callable[[], Iterable[Any]] = lambda: (None,)
) -> Callable[[Function], Function]:
    """Register a function from a task to rows; names of columns stand between spaces."""

    def register(rows: Function) -> Function:
        add(Study(name, tuple(columns.split()), tasks, rows, rows.__module__))
        return rows

    return register


def table(mark: str, page: str, *names: str) -> Callable[[Function], Function]:
    """Register a function from the rows of studies to a text, or to lines of a table."""

    def register(make: Function) -> Function:
        TABLES[mark] = Table(page, names, make)
        return make

    return register


def studies() -> dict[str, Study]:
    """All studies by name."""
    for module in MODULES:
        import_module(f"studies.{module}")
    return _STUDIES


def stale(folder: Path = DATA) -> Iterator[str]:
    """A line for each file with rows that other code than today's made."""
    for name, one in studies().items():
        if not (folder / f"{name}.csv").exists():
            continue
        rows, today = recorded(name, folder), one.version
        versions = (row["version"] for row in rows)
        other = Counter(version for version in versions if not same_code(version, today))
        if other:
            by = ", ".join(f"{version} ({count})" for version, count in other.most_common())
            yield f"{name}.csv: {other.total()} of {len(rows)} rows by {by}; today {today}"


# --- the pages -----------------------------------------------------------------------------------


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """Lines as a table; the first is its head."""
    head, *rest = ("| " + " | ".join(line) + " |" for line in lines)
    return "\n".join([head, "|---" * len(lines[0]) + "|", *rest])


def interval_of(row: Row, name: str, scale: float = 1.0) -> Interval:
    """A column of a row, times ``scale``, with its limits ``name_low`` and ``name_high``."""
    value, low, high = (float(row[f"{name}{end}"]) for end in ("", "_low", "_high"))
    return Interval(value, low, high).scaled(scale)


def codes_of(rows: Sequence[Row]) -> str:
    """The states of the code that made rows, each with how many where there are several."""
    found = Counter(row["version"].partition("+")[2] or row["version"] for row in rows)
    if len(found) == 1:
        return next(iter(found))
    return ", ".join(f"{code} ({count})" for code, count in found.most_common())


def origin(rows: Mapping[str, Sequence[Row]]) -> str:
    """Which code made the rows of some studies, and whether that is today's."""
    old = any(
        not same_code(row["version"], _STUDIES[name].version)
        for name, some in rows.items()
        for row in some
    )
    code = codes_of([row for some in rows.values() for row in some])
    age = ", measured with an earlier version of the code" if old else ""
    return f"Rows of code {code}{age}."


def between_marks(text: str, name: str, part: str) -> str:
    """The page with ``part`` between the marks of that name.

    Raises
    ------
    ValueError
        When the page lacks them.
    """
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    before, opened, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (opened and closed):
        raise ValueError(f"the page lacks the marks of {name!r}")
    return f"{before}{begin}{part}\n{end}{after}"


def pages() -> dict[Path, str]:
    """Each page that has tables, with its tables as the recorded rows have them."""
    studies()
    found: dict[Path, str] = {}
    for mark, one in TABLES.items():
        path = ROOT / "docs" / f"{one.page}.md"
        if not all((DATA / f"{name}.csv").exists() for name in one.studies):
            continue  # nothing is on record yet
        rows = {name: recorded(name) for name in one.studies}
        made = one.make(*rows.values())
        shown = made if isinstance(made, str) else markdown_table(made)
        if rows:
            shown = f"{shown}\n\n{origin(rows)}"
        text = found.get(path) or path.read_text(encoding="utf-8")
        found[path] = between_marks(text, mark, shown)
    return found
