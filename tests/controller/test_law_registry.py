"""A law of one's own is a class and a registration: everything that needs candidates takes it."""

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_service.laws.base import ProgramLaw
from controller_service.laws.errors import ProgramError
from controller_service.laws.planar import Planar
from controller_service.laws.registry import LAWS, cached_design, make_law
from controller_service.sets.design import Design, Progress, synthesise
from protocol.arrays import Array, Indices
from protocol.knowledge import Policy
from protocol.scenario import LAWS as TABLES
from protocol.scenario import Control, Scenario, ScenarioTable, parse_scenario
from runtime.user_code import UserCodeError
from tests.support.safety import violations
from tests.support.scenarios import text_of
from wyner.simulate.engine import simulate_runs
from wyner.simulate.network import Simulation


class Ends(ScenarioTable):
    share: float = 0.9


class EndsControl(Control):
    ends: Ends = Ends()

    def count_problems(self, candidates: int) -> Iterator[str]:
        if candidates != 2:
            yield f"secrecy.candidates: got {candidates}, expected 2 for the law ends"

    def policy(self, n: int, m: int) -> Policy:
        return Policy(law=self.law, costs=(), gain=self.gain)


class EndsLaw(ProgramLaw):
    """Offers points near both ends of the admissible interval, on sets for a larger D_c."""

    def __init__(self, scenario: Scenario, design: Design) -> None:
        super().__init__(scenario, design)
        assert isinstance(scenario.control, EndsControl)
        self.share = scenario.control.ends.share

    @classmethod
    def synthesise(cls, scenario: Scenario, progress: Progress | None = None) -> Design:
        larger = scenario.defender.disturbance.scaled(1.05)
        defender = scenario.defender.model_copy(update={"disturbance": larger})
        return synthesise(scenario.model_copy(update={"defender": defender}), progress)

    def answers(self, x: Sequence[float], i: int) -> tuple[tuple[float, ...], ...]:
        assert isinstance(self.programs, Planar)
        low, high = self.programs.interval(x[0], x[1], max(i - 1, 0))
        middle, half = 0.5 * (low + high), 0.5 * self.share * (high - low)
        return ((middle - half,), (middle + half,))

    def answers_many(self, X: Array, indices: Indices) -> Array:
        pairs = zip(X.tolist(), indices.tolist(), strict=True)
        return np.array([self.answers(x, i) for x, i in pairs])


def table(**control: Any) -> dict[str, Any]:
    data = tomllib.loads(text_of("sustained"))
    data["name"] = "ends"
    data["control"] |= {"law": "ends", "horizon": 60} | control
    return data


@pytest.fixture
def scenario(monkeypatch: pytest.MonkeyPatch) -> Scenario:
    monkeypatch.setitem(LAWS, "ends", f"{__name__}:EndsLaw")
    monkeypatch.setitem(TABLES, "ends", EndsControl)
    return parse_scenario(table(), "ends.toml")


def test_its_table_is_read_and_its_faults_are_told(scenario: Scenario) -> None:
    assert isinstance(scenario.control, EndsControl)
    assert scenario.knowledge().policy == Policy(law="ends", costs=(), gain=scenario.control.gain)
    other = parse_scenario(table(ends={"share": 0.5}), "ends.toml")
    assert other.design_fingerprint() != scenario.design_fingerprint()
    assert other.fingerprint() == scenario.fingerprint()


def test_its_design_is_its_own(scenario: Scenario, tmp_path: Path) -> None:
    design, again = (cached_design(scenario, cache_dir=tmp_path) for _ in range(2))
    assert again.cached
    usual = synthesise(scenario)
    assert design.T[0][1].max() > usual.T[0][1].max()


def test_the_engine_and_the_simulated_network_ask_it(scenario: Scenario) -> None:
    law = make_law(scenario, cached_design(scenario))
    runs = simulate_runs(scenario, law, seed=1, runs=range(3), steps=60, record=True)
    assert runs.x is not None
    assert runs.candidates is not None
    for k in (0, 30, 59):
        offered = law.candidates(runs.x[k, :, 2].tolist())
        assert [tuple(u) for u in runs.candidates[k, :, :, 2].tolist()] == list(offered)
    assert (runs.symbol >= 0).any()
    history = Simulation(scenario, law, seed=3, payloads=(b"x",)).run(steps=1200)
    assert list(violations(history, (b"x",))) == []
    assert history.delivered == [0]


@pytest.mark.parametrize(
    ("answers", "many", "expected"),
    [
        ("(0.0, 0.0)", "zeros", r"one state: got shape \(2,\), expected \(2, 1\)"),
        ("((0.0,), (0.0,))", "zeros[0]", r"many states: got shape \(2, 1\), expected \(1, 2, 1\)"),
        ("((0.0,), (0.0,))", "zeros + 0.1", r"got \[\[0.0\], \[0.0\]\] for one state and \[\[0.1"),
        (
            "((1e9,), (0.0,))",
            "zeros",
            r"got \[1000000000.0\], expected each in control.inputs",
        ),
        ("1 / 0", "zeros", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_law_of_ones_own_that_answers_no_candidates_is_one_line(
    tmp_path: Path, answers: str, many: str, expected: str
) -> None:
    path = tmp_path / "odd.py"
    path.write_text(
        "import numpy as np\nfrom controller_service.laws.base import ProgramLaw\n\n\n"
        "class Odd(ProgramLaw):\n"
        f"    def answers(self, x, i):\n        return {answers}\n\n"
        "    def answers_many(self, X, indices):\n"
        f"        zeros = np.zeros((len(X), 2, 1))\n        return {many}\n"
    )
    scenario = parse_scenario(table(law=f"{path}:Odd"), "odd.toml")
    design = cached_design(scenario)
    with pytest.raises(ProgramError, match=rf"^control\.law: \S+odd.py:Odd: .*{expected}") as told:
        make_law(scenario, design)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("u * np.nan", r"got \[nan\], expected each in control.inputs"),
        ("u + 100", r"got \[\d+\.\d+\], expected each in control.inputs"),
        ("u[:, :1]", r"got shape \((\d, )?1, 1\), expected \((\d, )?2, 1\), M candidates"),
        ("None", r"got shape \(\), expected \((\d, )?2, 1\)"),
        ("'none'", "ValueError: could not convert string to float"),
    ],
)
def test_a_law_of_ones_own_that_fails_far_from_the_origin_ends_who_asked_with_one_line(
    tmp_path: Path, answer: str, expected: str
) -> None:
    path = tmp_path / "far.py"
    path.write_text(
        "import numpy as np\nfrom controller_service.laws.base import ProgramLaw\n\n\n"
        "class Far(ProgramLaw):\n"
        "    def candidates(self, x):\n"
        "        found = self.candidates_many([x])\n"
        "        return None if found is None else found[0]\n\n"
        "    def candidates_many(self, X, indices=None):\n"
        "        u = super().candidates_many(X, indices)\n"
        "        if np.abs(X).max() <= 1:\n            return u\n"
        f"        return {answer}\n"
    )
    scenario = parse_scenario(table(law=f"{path}:Far"), "far.toml")
    law = make_law(scenario, cached_design(scenario))
    assert np.array_equal(law.candidates((0.1, 0.2)), law.candidates_many([(0.1, 0.2)])[0])
    line = rf"^control\.law: \S+far.py:Far: candidates .*({expected})"
    with pytest.raises(UserCodeError, match=line) as told:
        law.candidates((4.0, -2.0))
    assert "\n" not in str(told.value)
    assert "[4.0, -2.0]" in str(told.value) or "shape" in str(told.value)
    with pytest.raises(UserCodeError, match=line):
        law.candidates_many([(0.1, 0.2), (4.0, -2.0)])
    with pytest.raises(UserCodeError, match=line):
        simulate_runs(scenario, law, seed=1, runs=range(2), steps=30)
    with pytest.raises(LookupError, match="outside T_"):
        law.candidates((1e6, 0.0))
