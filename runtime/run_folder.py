"""A run's folder: where everything in it lies."""

from pathlib import Path
from typing import Final

MANIFEST: Final = Path("manifest.json")
SCENARIO: Final = Path("scenario.toml")
SUMMARY: Final = Path("summary.json")
MESSAGE: Final = Path("controller/message")
CONTROLLER_TRACE: Final = Path("controller/trace.jsonl")
CONTROLLER_JOURNAL: Final = Path("controller/journal.sqlite3")
CONTROLLER_STATUS: Final = Path("controller/status.json")
PLANT_TRACE: Final = Path("plant/trace.jsonl")
PLANT_JOURNAL: Final = Path("plant/journal.sqlite3")
PLANT_STATUS: Final = Path("plant/status.json")
PLANT_SAFE: Final = Path("plant/safe-state")
KNOWLEDGE: Final = Path("tap/knowledge.json")
VIEW: Final = Path("tap/view.json")
CAPTURE: Final = Path("tap/capture.jsonl")
GUESSES: Final = Path("tap/guesses.jsonl")
ANALYSIS_GUESSES: Final = Path("tap/analysis.jsonl")
BELIEFS: Final = Path("tap/beliefs.json")
TAP_STATUS: Final = Path("tap/status.json")
"""Paths below a run's folder."""


def loops_below(folder: Path) -> list[Path]:
    """The folders of a fleet's loops, by name; none where ``folder`` is a single run's."""
    if (folder / SCENARIO).exists():
        return []
    try:
        return sorted(path.parent for path in folder.glob(f"*/{SCENARIO}"))
    except OSError:
        return []
