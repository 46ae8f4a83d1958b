"""What must have come of a live loop that was ill-treated.

Every message must be there once, `wyner check` must pass, no honest step may alarm, and on the wire
no digit of the key stream may be named for two steps.
"""

from collections import Counter
from pathlib import Path

from pydantic_core import to_json

from protocol.messages import Offer
from protocol.secret.stream import NOWHERE
from runtime.recording import TraceError, parts_of, read_lines
from runtime.run_folder import CAPTURE
from tests.support.once import Digits
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.run import Run, RunError


def judged(run_dir: Path, expected: list[str], counts: Counter[str]) -> list[str]:
    """What was wrong with a run that is over; adds its figures to ``counts``.

    Parameters
    ----------
    run_dir : Path
    expected : list of str
        Every message that must have arrived once, the controller's first among them.
    counts : Counter
    """
    counts["messages"] = len(expected)
    wrong: list[str] = []
    try:
        wrong += _recovered(run_dir, expected, counts)
        wrong += _watched(run_dir, counts)
        evidence = read_evidence(run_dir)
        wrong += _digits(run_dir, evidence.rules.digits, counts)
        found = check(evidence)
    except (OSError, RunError, TraceError, ValueError) as error:
        return [*wrong, f"the run cannot be read: {error}"]
    plant = evidence.plant
    counts["transitions"] = 0 if plant is None else sum(plant.transitions.values())
    return wrong + [str(finding) for finding in found]


def _digits(run_dir: Path, count: int, counts: Counter[str]) -> list[str]:
    """Digits of the key stream that were named on the wire for two steps."""
    digits = Digits(count)
    for part in parts_of(run_dir / CAPTURE):
        for line in read_lines(part):
            if line.value is None or line.value.get("topic") != Offer.topic:
                continue
            offer = Offer.model_validate_json(to_json(line.value["message"]))
            counts["with digits"] += offer.position != NOWHERE
            try:
                digits.named(offer)
            except AssertionError as error:
                return [f"offer {offer.k}: {error}"]
    return []


def _watched(run_dir: Path, counts: Counter[str]) -> list[str]:
    """Steps that a key watched, and what honest steps must not do."""
    trace = Run.load(run_dir).columns("controller")
    counts["watched"] = int((trace.rows["expected"] != -1).sum())
    alarms = len(list(trace.told("alarm")))
    return [f"{alarms} honest steps made an alarm"] if alarms else []


def _recovered(run_dir: Path, expected: list[str], counts: Counter[str]) -> list[str]:
    trace = Run.load(run_dir).columns("plant")
    got = [told.payload.decode() for told in trace.told("recovered")]
    counts["sessions"] = len(trace.announced)
    seen = Counter(got)
    wrong = [
        f"{text[:20]!r} was recovered {seen[text]} times" for text in expected if seen[text] != 1
    ]
    return wrong + [f"{text[:20]!r} was never sent" for text in seen if text not in expected]
