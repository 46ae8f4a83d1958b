"""The second opinion: it agrees with honest runs, and sees what a replay cannot."""

from pathlib import Path

import numpy as np
import pytest

from protocol.agreement import NO_SYMBOL, AgreementResult, AgreementRule, predict
from protocol.box_observer import Box, BoxObserver
from protocol.schemes.base import Carry
from protocol.schemes.switched import Switched, SwitchedState
from tests.support.recorded_pair import RecordedPair
from wyner.runs.check import check
from wyner.runs.check.evidence import Finding, read_evidence
from wyner.runs.check.paper import NO_KEY, ROUNDING, Automata, f_c, output_scale, scale
from wyner.runs.check.paper import key_symbols as keys_of_scales

BOX = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.full(4, 0.5)
LARGE = BOX[0], 8 * BOX[1]


def key_symbols(*centres: tuple[float, float], x_next: tuple[float, float]) -> set[int]:
    """The keys of one transition."""
    one, of_one = np.array([x_next]), np.array([centres])
    keys = keys_of_scales(scale(*BOX, one, of_one), scale(*LARGE, one, of_one))
    return set(keys[0].tolist())


def recorded(folder: Path, name: str = "sustained", steps: int = 150) -> list[Finding]:
    run = RecordedPair(folder, b"hi", name=name)
    run.steps(steps, {4: "plant dies", 9: "offer lost", 30: "plant forgets"})
    run.stop()
    return check(read_evidence(folder))


# --- by hand --------------------------------------------------------------------------------------


def test_equation_5_by_hand() -> None:
    """Two transitions, of two candidates each."""
    A, B = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0], [6.0]])
    x, u = np.array([[1.0, 10.0], [0.0, 1.0]]), np.array([[[100.0], [0.0]], [[1.0], [-1.0]]])
    assert f_c(A, B, x, u).tolist() == [[[521, 643], [21, 43]], [[7, 10], [-3, -2]]]


def test_a_key_is_agreed_where_one_is_possible_for_the_defender_and_all_for_her() -> None:
    near, far, out = (0.0, 0.0), (2.0, 0.0), (9.0, 0.0)
    assert scale(*BOX, np.array([[0.25, -0.5]]), np.array([[near, far]])).tolist() == [[1.0, 3.5]]
    assert key_symbols(near, far, x_next=(0.1, 0.2)) == {0}
    assert key_symbols(far, near, x_next=(0.1, 0.2)) == {1}
    assert key_symbols(near, near, x_next=(0.1, 0.2)) == {NO_KEY}  # both possible
    assert key_symbols(near, out, x_next=(0.1, 0.2)) == {NO_KEY}  # one is none of hers
    assert key_symbols(far, far, x_next=(0.1, 0.2)) == {NO_KEY}  # d has left D_c
    assert key_symbols(near, far, far, x_next=(0.1, 0.2)) == {0}
    assert key_symbols(near, near, far, x_next=(0.1, 0.2)) == {NO_KEY}
    # to rounding either is right on the edge, and one alone a little beyond it
    assert key_symbols(near, far, x_next=(0.5, 0.0)) == {0, NO_KEY}
    assert key_symbols(near, far, x_next=(0.5 * (1 + 3 * ROUNDING), 0.0)) == {NO_KEY}


def test_figure_6_by_hand() -> None:
    """Test, agree on 1, carry 0 xor 1; then test again, whatever was seen meanwhile."""
    a = Automata(2)
    assert a.step(1, NO_KEY) == ("test", NO_KEY, NO_KEY, 0, 1, NO_KEY)
    assert a.step(0, 1) == ("test", NO_KEY, NO_KEY, 0, 2, 1)
    assert a.step(1, 0) == ("message", 1, 0, 1, 1, NO_KEY)
    assert a.step(0, 0) == ("test", NO_KEY, NO_KEY, 1, 2, 0)
    both = Automata(4, tests_always=True)
    both.step(0, 3)
    assert both.step(1, 2) == ("message", 3, 2, 1, 2, 2)
    assert both.step(1, NO_KEY) == ("message", 2, 3, 2, 1, NO_KEY)


# --- over runs ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["paper", "sustained", "packed", "quadruple-tank", "pendulum", "encoder", "noisy"]
)
def test_it_agrees_with_honest_runs(tmp_path: Path, name: str) -> None:
    assert recorded(tmp_path, name) == []
    ends = read_evidence(tmp_path).ends()
    assert sum(len(trace.rows) for trace in ends) > 250


def test_ends_that_agree_where_the_paper_does_not_fail_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A replay asks the broken function itself, and finds that it was evaluated correctly."""
    verdict_at = AgreementRule.verdict_at

    def generous(self: AgreementRule, predictions: object, x_next: object) -> AgreementResult:
        """The nearest candidate, also where two are possible."""
        found = verdict_at(self, predictions, x_next)  # type: ignore[arg-type]
        return found._replace(symbol=found.gauges.index(min(found.gauges)))

    monkeypatch.setattr(AgreementRule, "verdict_at", generous)
    monkeypatch.setattr(
        AgreementRule,
        "verdict",
        lambda self, x, candidates, x_next: generous(
            self, [predict(self.A, self.B, x, u) for u in candidates], x_next
        ),
    )
    found = recorded(tmp_path)
    assert {f.rule for f in found} == {"paper"}
    assert "Fig. 5 gives" in found[0].text


def test_ends_whose_automata_are_not_the_papers_fail_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An automaton that stays in state 2 uses a key for more than one symbol."""

    def stuck(self: Switched, state: SwitchedState, verdict: int) -> tuple[SwitchedState, Carry]:
        if state.s == 2:
            return state, Carry(NO_SYMBOL, state.key)
        after = SwitchedState(1, NO_SYMBOL) if verdict == NO_SYMBOL else SwitchedState(2, verdict)
        return after, Carry(verdict, NO_SYMBOL)

    for name in ("advance", "follow"):  # what it remembers is of the whole process
        monkeypatch.setattr(Switched, name, stuck)
    assert {f.rule for f in recorded(tmp_path)} == {"paper", "once"}


@pytest.mark.parametrize("outputs", [1, 2, 3])
def test_which_candidates_explain_a_reading_of_outputs(outputs: int) -> None:
    """As the ends' own box says, which rounds outwards; readings lie about as far as they may."""
    draw = np.random.default_rng(outputs)
    n, m, M, K = 3, 2, 4, 300
    edges = alone = 0
    for _ in range(10):
        A, B = draw.normal(size=(n, n)), draw.normal(size=(n, m))
        C = draw.normal(size=(outputs, n)) * (draw.random((outputs, n)) < 0.7)
        C[:, 0] += 0.1
        D_c, N = draw.uniform(0.01, 0.1, n), draw.uniform(0.01, 0.1, outputs)
        observer = BoxObserver(
            A=tuple(map(tuple, A.tolist())),
            B=tuple(map(tuple, B.tolist())),
            C=tuple(map(tuple, C.tolist())),
            disturbance=tuple(D_c.tolist()),
            noise=tuple(N.tolist()),
            bounds=(1e3,) * n,
        )
        low = draw.normal(size=(K, n))
        box = np.stack([low, low + draw.uniform(0.0, 0.2, (K, n))], axis=1)
        u = 0.3 * draw.normal(size=(K, M, m))
        x = box[:, 0] + (box[:, 1] - box[:, 0]) * draw.random((K, n))
        d = D_c * draw.uniform(-1.5, 1.5, (K, n))
        noise = N * draw.uniform(-1.5, 1.5, (K, outputs))
        y = (x @ A.T + u[:, 0] @ B.T + d) @ C.T + noise
        found = output_scale(A, B, C, box, u, D_c, N, y)
        assert set(found.ravel()) <= {0.0, 1.0, 2.0}
        for i in range(K):
            its = Box(*(tuple(v) for v in box[i].tolist()))
            told = set(observer.step(its, u[i].tolist(), y[i].tolist()).possible)
            sure, most = (set(np.flatnonzero(found[i] <= edge).tolist()) for edge in (0.5, 1.5))
            assert sure <= told <= most
            edges += sure != most
            alone += len(told) == 1
    assert edges <= 2
    assert alone > 300
