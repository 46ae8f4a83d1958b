"""The study of the attacks: its rows say what the theorems say, and what is measured again."""

import numpy as np
import pytest

from protocol.statistics import clopper_pearson
from studies.__main__ import main
from studies.attacks import study
from studies.attacks.study import EYES, seen_through, tasks
from studies.attacks.tables import unseen
from studies.registry import Row, recorded, studies
from studies.signalling import changed

RARE = 1e-6


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return recorded("attacks")


def test_shares_are_within_binomial_error_of_the_theory(rows: list[Row]) -> None:
    checked = set()
    for row in rows:
        if not row["theory"]:
            continue
        runs, each = int(row["runs"]), float(row["theory"])
        for n, left in enumerate(unseen(row)[:8]):
            low, high = clopper_pearson(left, runs, RARE)
            assert low <= each**n * (1 + 1e-9), (row["attack"], row["M"], n)
            assert high >= each**n * (1 - 1e-9), (row["attack"], row["M"], n)
        checked.add((row["scenario"], row["M"], row["defence"]))
    assert {("packed", m, "keyed-coin") for m in "234"} <= checked
    assert ("packed-quadruple-tank", "16", "keyed-coin") in checked
    assert ("packed", "4", "Gaussian watermark") in checked


def test_who_has_the_key_decides(rows: list[Row]) -> None:
    mine = {
        (row["attack"], row["defence"], row["key"]): row for row in rows if row["group"] == "key"
    }
    for key in ("false claim", "nearest-centre"):
        row = mine["ghost", "keyed-coin", key]
        assert unseen(row)[-1] == int(row["runs"]) == int(row["held"])
        assert float(row["away"]) > 30
        assert float(row["shown_largest"]) < 3
    row = mine["ghost", "keyed-coin", "secret"]
    assert (unseen(row)[40], row["held"]) == (0, "0")
    assert float(row["away_largest"]) < 3
    row = mine["ghost", "residual", "nobody"]
    assert unseen(row)[100] == int(row["runs"])


def test_the_limit_and_the_baseline(rows: list[Row]) -> None:
    (limit,) = (row for row in rows if row["group"] == "limit")
    assert unseen(limit)[100] == int(limit["runs"])
    assert float(limit["away"]) > 30
    bus = {(r["attack"], r["defence"], r["key"]): r for r in rows if r["group"] == "bus"}
    for attack in ("covert, 0.3", "covert, 0.1"):
        assert unseen(bus[attack, "mac", "secret"])[2] == 0
        assert unseen(bus[attack, "coding + keyed-coin", "secret"])[10] == 0
        for defence, key in (
            ("residual", "nobody"),
            ("coding + keyed-coin", "false claim"),
            ("mac", "false claim"),
        ):
            row = bus[attack, defence, key]
            assert unseen(row)[60] == int(row["runs"]), (attack, defence)
            assert float(row["away"]) > 4


def test_no_honest_step_alarms(rows: list[Row]) -> None:
    assert sum(int(row["false_alarms"]) for row in rows) == 0
    honest = [row for row in rows if row["group"] == "honest"]
    assert len(honest) == 7
    assert sum(int(row["honest_steps"]) for row in honest) >= 1e7


@pytest.mark.slow
def test_a_row_measured_again_is_the_same(rows: list[Row]) -> None:
    by_task = {row["task"]: row for row in rows}
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


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["measure", "attacks", "--jobs", "0"], "--jobs: got 0, expected at least 1"),
    ],
)
def test_what_cannot_be_is_one_line(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert line in capsys.readouterr().err
