"""What goes over a live loop while it is ill-treated, and what must have come of it at the end.

Every message must be there once, every service must end with code 0 when it is asked to, `wyner
check` must pass, and on the wire no digit of the key stream may be named for two steps.
"""

import random
import time
from collections import Counter
from pathlib import Path
from types import TracebackType
from typing import Final

from pydantic_core import to_json

from protocol.messages import Offer
from protocol.secret.stream import NOWHERE
from runtime.recording import TraceError, parts_of, read_lines
from runtime.run_folder import CAPTURE
from tests.campaigns.live import LiveLoop, Process, all_done, plain_text, wait_for
from tests.support.once import Digits
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.run import Run, RunError

AT_LAST_S: Final = 120.0
"""Seconds that a loop has to deliver what is queued, once all is well."""


class Traffic:
    """A loop that runs inside ``with``, and its messages.

    Attributes
    ----------
    expected : list of str
        Every message that must arrive once, the controller's first among them.
    wrong : list of str
        What was wrong, in a line each.
    """

    def __init__(self, loop: LiveLoop, first: str, draw: random.Random) -> None:
        self.loop, self.expected, self.draw = loop, [first], draw
        self.wrong: list[str] = []
        self.operators: list[Process] = []

    def __enter__(self) -> "Traffic":
        self.loop.start()
        return self

    def send(self) -> None:
        """Hand over one message more."""
        name, text = f"message-{len(self.operators)}", plain_text(self.draw, 12)
        self.expected.append(text)
        self.operators.append(self.loop.send(name, text))

    def arrive(self) -> None:
        """All is well now: wait until every message has arrived."""
        if not wait_for(lambda: all_done(self.operators), AT_LAST_S):
            self.wrong.append("an operator has no answer")
        well = self.loop.mark()
        if not wait_for(lambda: self.loop.delivered(well) == len(self.expected), AT_LAST_S):
            self.wrong.append(f"{self.loop.delivered(well)} messages arrive although all is well")
        self.loop.start()
        time.sleep(0.5)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.wrong += self.loop.stop()
        for operator in self.operators:
            operator.kill()

    def judged(self, counts: Counter[str]) -> list[str]:
        """What was wrong with a run that is over; adds its figures to ``counts``."""
        counts["messages"] = len(self.expected)
        run_dir = self.loop.run_dir
        try:
            self.wrong += _recovered(run_dir, self.expected, counts)
            self.wrong += _watched(run_dir, counts)
            evidence = read_evidence(run_dir)
            self.wrong += _digits(run_dir, evidence.rules.digits, counts)
            found = check(evidence)
        except (OSError, RunError, TraceError, ValueError) as error:
            return [*self.wrong, f"the run cannot be read: {error}"]
        plant = evidence.plant
        counts["transitions"] = 0 if plant is None else sum(plant.transitions.values())
        return self.wrong + [str(finding) for finding in found]


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
