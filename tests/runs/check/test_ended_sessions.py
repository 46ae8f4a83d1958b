"""An alarm that comes with a session's first reading: who ends each session at its first step."""

import json
from pathlib import Path

import pytest

from protocol.messages import Measurement
from runtime.run_folder import CONTROLLER_TRACE
from tests.support.checked_runs import failed
from tests.support.mail import Mail, mail
from tests.support.recorded_pair import RecordedPair
from tests.support.traces import events_of

ONSET = 200
STEPS = 250
"""After these 180 of them are too many, once."""


class Ended(RecordedPair):
    """A forged reading ends each session before the controller has heard of its first step."""

    def _attacked(self, message: Mail) -> Mail:
        attacked = ONSET <= self.plant.state.record.link.k < ONSET + STEPS
        if message.kind is not Measurement or not attacked:
            return message
        m = Measurement.model_validate_json(message.payload)
        if m.applied_k < 0:
            return message
        forged = {"k": m.k + 1000, "applied_k": m.k + 999, "x_after": m.x}
        return mail(m.model_copy(update=forged))


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ended") / "run"
    loop = Ended(folder, name="watched")
    loop.run(lambda: loop.plant.state.record.link.k >= ONSET + STEPS + 5)
    loop.stop()
    return folder


@pytest.mark.slow
def test_the_alarm_is_told_and_checked(ended: Path) -> None:
    told = events_of(ended / CONTROLLER_TRACE, "alarm")
    assert [(alarm["j"], alarm["reason"]) for alarm in told] == [(-1, "unwatched")]
    assert ONSET + 180 < told[0]["k"] < ONSET + 210
    assert "alarms" not in failed(ended)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["none", "early"])
def test_an_alarm_that_is_missing_or_too_early_fails(ended: Path, wrong: str) -> None:
    path = ended / CONTROLLER_TRACE
    right = path.read_bytes()
    lines = right.splitlines(keepends=True)
    (at,) = [i for i, line in enumerate(lines) if json.loads(line)["event"] == "alarm"]
    alarm = lines.pop(at)
    if wrong == "early":
        lines.insert(at - 40, alarm)
    path.write_bytes(b"".join(lines))
    try:
        assert "alarms" in failed(ended)
    finally:
        path.write_bytes(right)
