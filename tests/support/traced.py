"""Lines of a trace by hand, whole as the services write them; and a run's traces made of them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from protocol.link.events import MET, NEW_JOURNAL
from runtime.recording import TraceWriter
from runtime.run_folder import SCENARIO
from tests.support.scenarios import text_of
from wyner.runs.run import TRACES, Run


def session(name: str, reason: str = NEW_JOURNAL) -> dict[str, Any]:
    """The line with which a plant's session begins."""
    return {"event": "session", "session": name, "reason": reason}


def met(name: str) -> dict[str, Any]:
    """The same at the controller."""
    return session(name, MET)


def write_run(run_dir: Path, scenario: str, **traces: Iterable[dict[str, Any]]) -> Run:
    """A run of a shipped scenario with these traces, by side."""
    run_dir.mkdir(exist_ok=True)
    (run_dir / SCENARIO).write_text(text_of(scenario))
    for side, path in TRACES.items():
        if side in traces:
            trace = TraceWriter(run_dir / path, side, {})
            for line in traces[side]:
                trace.write(line)
            trace.close()
    return Run.load(run_dir)


def transition(session: str, j: int, k: int, *, size: int = 2, **fields: Any) -> dict[str, Any]:
    """A test transition of the plant's trace, of two states and one input, with these fields."""
    line: dict[str, Any] = {"event": "transition", "session": session, "j": j, "k": k}
    line |= {"x": [0.0, 0.0], "candidates": [[float(i)] for i in range(size)], "cipher": 0}
    line |= {"x_next": [0.0, 0.0], "role": "test", "gauges": [1.0] * size, "symbol": -1}
    line |= {"key": -1, "message_symbol": -1, "p": 0, "s": 1, "counts": 0, "coin": 0, "u": [0.0]}
    return line | fields


def at_controller(line: dict[str, Any], **fields: Any) -> dict[str, Any]:
    """The same transition in the controller's trace."""
    kept = {name: value for name, value in line.items() if name not in ("coin", "u")}
    return kept | fields
