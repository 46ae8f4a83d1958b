"""The study of the attacks: its rows are measured again."""

import numpy as np
import pytest

from studies.__main__ import main
from studies.attacks import study
from studies.attacks.study import EYES, seen_through, tasks
from studies.registry import recorded, studies
from studies.signalling import changed

RARE = 1e-6


@pytest.mark.slow
def test_a_row_measured_again_is_the_same() -> None:
    by_task = {row["task"]: row for row in recorded("attacks")}
    again = [t for t in tasks() if t.group == "matrix" and t.attack in ("ghost", "covert, 0.3")]
    for task in again[:6]:
        (fresh,) = studies()["attacks"].measured(task)
        for name in set(fresh) - {"version"}:
            assert fresh[name] == by_task[task.id][name], (task, name)


def test_an_eye_is_as_sharp_as_one_that_is_drawn() -> None:
    scenario = changed("packed")
    draw = np.random.default_rng(7)
    _, law = study.loop_of("packed", 4, "")
    offsets = law.candidates_many(np.zeros((1, 2)), law.indices(np.zeros((1, 2))))[0, :, 0]
    push = offsets[:, None] * np.array(scenario.B)[:, 0]
    for noise, stated in zip(EYES, (0.966, 0.762, 0.538), strict=True):
        coins = draw.integers(4, size=100_000)
        seen = push[coins] + noise * draw.standard_normal((100_000, 2))
        nearest = ((seen[:, None] - push) ** 2).sum(-1).argmin(1)
        assert seen_through(noise, scenario) == pytest.approx((nearest == coins).mean(), abs=0.006)
        assert seen_through(noise, scenario) == pytest.approx(stated, abs=5e-4)


def test_no_process_at_all_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure", "attacks", "--jobs", "0"]) == 2
    assert "--jobs: got 0, expected at least 1" in capsys.readouterr().err
