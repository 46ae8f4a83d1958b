"""Which files of a run's folder are evidence, and what holds each of them to what it was.

A file that matches none of the patterns is no evidence: a page, a table or a copy that somebody put
there. What goes on being written beside a run that is over (a lock) is none
either.
"""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, NamedTuple


class FileKind(NamedTuple):
    """Files of one kind.

    Parameters
    ----------
    pattern : str
        Of their path below the run's folder, as a shell reads it.
    evidence : bool
        Whether a run is judged by them, so that a change of one fails the check.
    held_by : str
        The rules that notice a change; of what is no evidence, why it is none.
    """

    pattern: str
    evidence: bool
    held_by: str


SEAL: Final = "the seal"
_BOTH: Final = "replayed; its end marks, its journal, the seal"

KINDS: Final = (
    FileKind("manifest.json", True, "whole: a digest of itself"),
    FileKind("scenario.toml", True, "whole, and every rule that computes; the seal"),
    FileKind("plant/trace*.jsonl", True, _BOTH),
    FileKind("controller/trace*.jsonl", True, _BOTH),
    FileKind("plant/journal.sqlite3*", True, "whole, messages; the seal"),
    FileKind("controller/journal.sqlite3*", True, "whole, messages; the seal"),
    FileKind("tap/capture*.jsonl", True, "bus, wire, once, same-keys, end marks, the seal"),
    FileKind("tap/guesses*.jsonl", True, "whole: its end marks; the seal"),
    FileKind("tap/analysis*.jsonl", True, "whole: its end marks; the seal"),
    FileKind("tap/status.json", True, "whole: its count of the capture; the seal"),
    FileKind("tap/beliefs.json", True, SEAL),
    FileKind("tap/knowledge.json", True, SEAL),
    FileKind("tap/view.json", True, SEAL),
    FileKind("controller/message", True, SEAL),
    FileKind("summary.json", True, SEAL),
    FileKind("plant/status.json", True, SEAL),
    FileKind("controller/status.json", True, SEAL),
    FileKind("plant/log", True, SEAL),
    FileKind("controller/log", True, SEAL),
    FileKind("tap/log", True, SEAL),
    FileKind("*/.*", False, "on its way to its name, or the one before it"),
    FileKind("*/log.old", False, "a log that was begun again"),
    FileKind("*/lock", False, "empty"),
    FileKind("report.html", False, "made of the run, and can be made again"),
)
"""In this order: the first that a file matches is its kind."""

OTHER: Final = FileKind("anything else", False, "not the run's own")


def kind_of(name: str) -> FileKind:
    """The kind of a file, by its path below the run's folder."""
    return next((kind for kind in KINDS if fnmatchcase(name, kind.pattern)), OTHER)


def evidence_below(run_dir: Path) -> list[Path]:
    """The files of a run's folder that carry evidence, by name; links are left out.

    Others may come and go meanwhile.
    """
    found = []
    for folder in ("", "controller", "plant", "tap"):
        for path in (run_dir / folder).glob("*"):
            if kind_of(str(path.relative_to(run_dir))).evidence and not path.is_symlink():
                found.append(path)
    return sorted(path for path in found if path.is_file())
