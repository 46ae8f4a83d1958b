"""The ladder on seeded runs: what each must get, and the controls that must fail."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic_core import from_json

from protocol.knowledge import Knowledge
from protocol.secret.bound import Assumption
from protocol.statistics import confidence_sequence
from studies.secrecy.runs import Run, simulate
from studies.secrecy.study import ALPHAS, heard_by, knowledge_for, output_about
from tap_service.capture.channel import View
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import (
    LADDER,
    Belief,
    Eavesdropper,
    Guess,
    KnowledgeError,
    named,
    reading,
)
from tap_service.eavesdroppers.base import MessageSymbols
from tap_service.listening import Listener, sound_belief, sound_guess
from tap_service.status import beliefs_json, report_of
from tests.support.size import size
from wyner.runs.score.score import SILENT, EavesdropperScore, TapOutput, score

CLEAR = View()

LEARNING = size([], ["learning"])
"""She reads as `list-decoder` does once she has a model: in the gate her own tests say so."""


def play(run: Run, name: str, view: View = CLEAR) -> tuple[TapOutput, EavesdropperScore]:
    kind = named(name)
    said = output_about(kind(knowledge_for(run, kind, view)), heard_by(run, view))
    return said, score(run.truth, said)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(ALPHAS), st.integers(0, 10**6))
def test_nearest_centre_is_never_wrong_on_an_agreed_step(alpha: float, seed: int) -> None:
    run = simulate(150, seed, alpha=alpha)
    _, scored = play(run, "nearest-centre")
    assert scored.keys.right == scored.keys.of


def test_set_membership_guesses_blindly_on_agreed_steps() -> None:
    scores = [play(simulate(1000, seed), "set-membership")[1] for seed in range(4)]
    keys = confidence_sequence(sum(s.keys.right for s in scores), sum(s.keys.of for s in scores))
    assert keys.low < 0.5 < keys.high


@pytest.mark.parametrize("seed", size((2,), range(4)))
@pytest.mark.parametrize("name", ["list-decoder", "oracle"])
def test_the_framed_message_is_had_when_the_plant_has_it(name: str, seed: int) -> None:
    run = simulate(500, seed, payloads=[b"Go now"])
    said, scored = play(run, name)
    assert run.truth.whole
    assert said.belief.whole == tuple(p for _, p in run.truth.whole)
    assert said.belief.solved_k == run.truth.whole[0][0]
    assert scored.bits.right >= scored.bits.of - 0.5


@pytest.mark.parametrize("name", ["nearest-centre", "text", *LEARNING])
def test_on_a_clear_view_she_names_the_message_symbols(name: str) -> None:
    _, scored = play(simulate(400, 0), name)
    assert scored.bits.of > 90
    assert scored.bits.right >= 0.99 * scored.bits.of


def test_several_messages_come_in_order() -> None:
    payloads = [b"a", b"b"]
    run = simulate(500, 7, payloads=payloads)
    assert len(run.truth.whole) == 2
    for name in ("list-decoder", "oracle"):
        belief = play(run, name)[0].belief
        assert (belief.whole, belief.whole_count) == (tuple(payloads), 2)


@pytest.mark.long
def test_the_learner_starts_from_nothing() -> None:
    exact = right = of = 0
    for seed in range(size(1, 3)):
        run = simulate(size(480, 1200), seed, payloads=[size(b"Go now", b"Meet at six")])
        said, scored = play(run, "learning")
        exact += said.belief.whole == tuple(p for _, p in run.truth.whole)
        early = {at: v for at, v in run.truth.keys.items() if at[1] < 200}
        right += sum(said.reviewed.get(at) == v for at, v in early.items())
        of += len(early)
        assert scored.keys_reviewed.right >= 0.99 * scored.keys_reviewed.of
    assert exact >= size(1, 2)
    assert right >= 0.95 * of


@pytest.mark.long
@pytest.mark.parametrize("error", size([0.5], [0.1, 0.3, 0.5]))
def test_the_learner_starts_from_a_wrong_model(error: float) -> None:
    exact = 0
    for seed in range(size(1, 2)):
        run = simulate(size(480, 1200), 100 + seed, payloads=[size(b"Go now", b"Meet at six")])
        said, _ = play(run, "learning", View(model_error=error, seed=seed))
        exact += said.belief.whole == tuple(p for _, p in run.truth.whole)
    assert exact >= 1


@pytest.mark.long
def test_text_gains_over_the_list_decoder_when_messages_are_lost() -> None:
    view = View(loss=0.3, seed=3)
    run = simulate(size(200, 400), 3)
    plain, smooth = (play(run, name, view)[1] for name in ("list-decoder", "text"))
    assert smooth.keys_reviewed.right > plain.keys_reviewed.right
    blind = 0.5 * smooth.keys.of
    assert smooth.keys_reviewed.right - blind > 1.15 * (plain.keys_reviewed.right - blind)


def keeping(steps: int, patch: pytest.MonkeyPatch) -> None:
    """She lets go of the older half of so many."""
    patch.setattr(reading, "KEPT", steps)


@pytest.mark.long
@pytest.mark.parametrize("name", ["list-decoder", "learning", "text", "oracle"])
def test_a_run_longer_than_she_keeps_loses_no_message(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages one after the other, across the steps at which she lets go of the older half."""
    keeping(size(512, 1024), monkeypatch)
    payloads = [size(b"%02d", b"message number %02d") % i for i in range(10)]
    run = simulate(size(900, 3000), 1, payloads=payloads)
    said, scored = play(run, name)
    assert len(run.truth.whole) >= 3
    assert said.belief.whole == tuple(p for _, p in run.truth.whole)
    assert scored.keys_reviewed.right == scored.keys_reviewed.of
    assert scored.bits.right >= scored.bits.of - 1


@pytest.mark.long
@pytest.mark.parametrize("name", ["text", *LEARNING])
def test_a_message_longer_than_she_keeps_is_had(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    keeping(size(512, 1024), monkeypatch)
    long = b"It was a quiet night at the harbour and nobody saw the boats leave."
    text = size(long[:20], long)
    run = simulate(size(1300, 3300), 1, payloads=[text])
    assert [p for _, p in run.truth.whole] == [text]
    assert play(run, name)[0].belief.whole == (text,)


@pytest.mark.long
def test_second_thoughts_on_what_she_lets_go_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    keeping(128, monkeypatch)
    run = simulate(size(132, 200), 3, payloads=[b"let go"])
    view = View(loss=0.02, seed=1)
    said, scored = play(run, "text", view)
    oldest = [at for at in said.live if at[1] < 60]
    assert len(oldest) > 50
    assert all(at in said.reviewed for at in oldest)
    assert scored.keys_reviewed.right > scored.keys.right


# --- negative controls ---------------------------------------------------------------------------


def test_alpha_one_agrees_no_key() -> None:
    assert not simulate(1000, 1, alpha=1.0).truth.keys


def knowing(run: Run, name: str) -> Knowledge:
    """What she is told, and a claim for the one who goes for keys."""
    return knowledge_for(run, named(name), CLEAR).model_copy(update={"keys": Assumption(0.3)})


@pytest.mark.parametrize("name", LADDER)
def test_who_sees_nothing_guesses_like_a_coin(name: str) -> None:
    run = simulate(300, 6)
    tap = named(name)(knowing(run, name))
    holes = [Transition(t.session, t.k, None, None, None, None) for t in heard_by(run, CLEAR)]
    said = output_about(tap, holes)
    assert not said.belief.whole
    guesses = [*map(tap.observe, holes), *tap.review()]
    assert max(max(g.symbol) for g in guesses) == 0.5
    right = score(run.truth, said).keys
    assert 0.35 < (right.share or 0) < 0.65  # the first of two equals, on some 65 keys


@pytest.mark.parametrize("view", [CLEAR, View(loss=0.3, seed=1)], ids=["clear", "lossy"])
@pytest.mark.parametrize("name", LADDER)
def test_all_that_she_says_is_probabilities_and_no_step_is_thought_of_twice(
    name: str, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the way she lets go of steps: their second thoughts are told, and then no more."""
    keeping(48, monkeypatch)
    run = simulate(60, 6)
    heard = heard_by(run, view)
    tap = named(name)(knowing(run, name))
    live = [tap.observe(t) for t in heard]
    second = [*tap.final_guesses, *tap.review()]
    for guess in (*live, *second):
        assert sound_guess(guess, tap.size).agreed <= 1.0
    assert sound_belief(tap.belief()).confidence <= 1.0
    steps = [t.k for t in heard]
    assert [guess.k for guess in live] == steps
    assert [guess.k for guess in second] in ([], steps)


@pytest.mark.parametrize("name", LADDER)
def test_who_was_there_and_heard_no_message_is_not_scored(name: str) -> None:
    """A tap at the wrong address hears nothing, and that is no secrecy."""
    run = simulate(300, 6)
    heard = heard_by(run, View(loss=1.0))
    assert heard == []
    said = output_about(named(name)(knowing(run, name)), heard)
    scored = score(run.truth, said)
    assert scored.keys.of == scored.bits.of == 0
    assert scored.why_unscored == SILENT


@pytest.mark.parametrize("name", ["oracle", "list-decoder", *LEARNING])
def test_a_corrupted_key_is_refused_by_the_frame_check(name: str) -> None:
    assert simulate(400, 8, payloads=[b"Noon"]).truth.whole
    run = simulate(400, 8, payloads=[b"Noon"], corrupt=40)
    assert not run.truth.whole
    assert play(run, name)[0].belief.whole == ()


# --- the interface -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nobody", "expected set-membership"),
        ("missing.py:Tap", "missing.py: no such file"),
        ("{file}:Absent", "expected a class Absent"),
        ("{file}:Nameless", "expected a class attribute name .* got None"),
        ("{file}:Quoted", "expected a class attribute name .* got 'my \"tap\"'"),
        ("{file}:Silent", "expected the methods that it lacks: belief, observe$"),
        ("{broken}:Tap", "cannot be loaded: ZeroDivisionError"),
    ],
)
def test_a_wrong_name_is_one_line(tmp_path: Path, name: str, expected: str) -> None:
    file, broken = tmp_path / "mine.py", tmp_path / "broken.py"
    file.write_text(
        "from tap_service.eavesdroppers import Eavesdropper\nclass Nameless(Eavesdropper): pass\n"
        "class Quoted(Eavesdropper): name = 'my \"tap\"'\n"
        "class Silent(Eavesdropper): name = 'silent'\n"
    )
    broken.write_text("1 / 0\n")
    with pytest.raises(KnowledgeError, match=expected) as error:
        named(name.format(file=file, broken=broken))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["set-membership", "nearest-centre", "list-decoder", "text", "oracle"]
)
def test_one_who_needs_a_model_says_what_she_lacks(name: str) -> None:
    with pytest.raises(KnowledgeError, match=f"{name}: knowledge lacks A, B"):
        named(name)(Knowledge(scenario="s", period_s=0.1, candidates=2))


def test_the_oracle_needs_alpha() -> None:
    run = simulate(1, 0)
    with pytest.raises(KnowledgeError, match="lacks alpha"):
        named("oracle")(run.scenario.knowledge())


class Odd(Eavesdropper):
    """Answers whatever it is told to."""

    name = "odd"
    guess: object = Guess(0, (0.5, 0.5), 0.5)
    thoughts: object = ()
    last_belief: object = Belief()
    symbols: object = ()

    def observe(self, transition: Transition) -> Guess:
        return cast("Guess", self.guess)

    def review(self) -> Sequence[Guess]:
        return cast("Sequence[Guess]", self.thoughts)

    def belief(self) -> Belief:
        return cast("Belief", self.last_belief)

    def message_symbols(self) -> MessageSymbols:
        return cast("MessageSymbols", self.symbols)


def odd(**answers: object) -> Listener:
    run = simulate(3, 0)
    listener = Listener(Odd, run.scenario.knowledge())
    for name, answer in answers.items():
        setattr(listener.tap, name, answer)
    for transition in heard_by(run, CLEAR):
        listener.observe(transition)
    return listener


PROBABILITIES = "step 0: ValueError: expected 2 probabilities"


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        ({"guess": None}, "step 0: TypeError: expected a Guess, got None"),
        ({"guess": Guess(0, (), 0.5)}, PROBABILITIES),
        ({"guess": Guess(0, (0.5, 0.6, 0.1), 0.5)}, PROBABILITIES),
        ({"guess": Guess(0, (0.5, 0.6), 0.5)}, f"{PROBABILITIES} that sum to 1"),
        ({"guess": Guess(0, (0.2, 0.3), 0.5)}, f"{PROBABILITIES} that sum to 1"),
        ({"guess": Guess(0, (-0.5, 1.5), 0.5)}, PROBABILITIES),
        ({"guess": Guess(0, (0.5, float("nan")), 0.5)}, PROBABILITIES),
        ({"guess": Guess(0, (0.5, 0.5), 1.5)}, PROBABILITIES),
        ({"guess": Guess(0.5, (0.5, 0.5), 0.5)}, "step 0: TypeError: 'float' object"),  # type: ignore[arg-type]
        ({"last_belief": None}, "belief: TypeError: expected a Belief, got None"),
        ({"last_belief": Belief(message="hello")}, "belief: TypeError: expected messages as bytes"),  # type: ignore[arg-type]
        ({"last_belief": Belief(whole=("a",))}, "belief: TypeError: expected messages as bytes"),  # type: ignore[arg-type]
        ({"last_belief": Belief(confidence=2.0)}, "belief: ValueError: expected a confidence"),
        ({"last_belief": Belief(A=((float("inf"),),))}, "belief: ValueError: expected a finite"),
        ({"symbols": None}, "message_symbols: TypeError: expected steps and symbols, got None"),
        ({"symbols": ((1, 0), (2,))}, "message_symbols: ValueError: expected pairs of step and"),
        ({"symbols": (("k", 0),)}, "message_symbols: TypeError"),
    ],
)
def test_an_answer_that_is_none_stops_her_alone(answer: dict[str, object], expected: str) -> None:
    """Message symbols are asked for at the end."""
    listener = odd(**answer)
    assert listener.steps == (0 if "guess" in answer else 3)
    assert listener.belief() == Belief()
    _, early = report_of("s", listener, last=False)
    assert (early["failed"] == "") == ("symbols" in answer)
    _, last = report_of("s", listener, last=True)
    assert last["failed"].startswith(expected)
    assert "\n" not in last["failed"]
    assert last["symbols"] is None


def test_second_thoughts_that_are_none_stop_her_alone() -> None:
    listener = odd(thoughts=None)
    assert listener.review() == ()
    assert listener.failed.startswith("review: TypeError")
    listener = odd()
    listener.tap.final_guesses = [Guess(0, (1.0,), 0.0)]
    assert listener.final_guesses() == ()
    assert listener.failed.startswith("final_guesses: ValueError")


def test_numbers_of_another_kind_are_taken_as_plain_ones() -> None:
    symbol = np.array([0.25, 0.75])
    listener = odd(
        guess=Guess(np.int64(3), symbol, np.float32(0.5)),  # type: ignore[arg-type]
        last_belief=Belief(A=np.eye(2)),  # type: ignore[arg-type]
        symbols=[(np.int64(1), np.int8(0))],
    )
    assert not listener.failed
    assert list(listener.tail) == [Guess(3, (0.25, 0.75), 0.5)] * 3
    status, record = report_of("s", listener, last=True)
    assert [guess.symbol for guess in status.tail] == [1, 1, 1]
    assert from_json(beliefs_json({"odd": record}))["odd"]["symbols"] == [[1, 0]]


def test_one_who_cannot_be_made_is_one_line() -> None:
    class Fragile(Odd):
        name = "fragile"

        def __init__(self, knowledge: Knowledge) -> None:
            raise ValueError("no\nway")

    class Abstract(Eavesdropper):
        name = "abstract"

    knowledge = simulate(1, 0).scenario.knowledge()
    for kind, expected in ((Fragile, "ValueError: no way"), (Abstract, "TypeError: ")):
        with pytest.raises(KnowledgeError, match=f"{kind.name}: cannot be made: {expected}") as e:
            Listener(kind, knowledge)
        assert "\n" not in str(e.value)


def test_a_file_with_a_dataclass_and_late_annotations_is_loaded(tmp_path: Path) -> None:
    file = tmp_path / "late.py"
    file.write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "from tap_service.eavesdroppers import Eavesdropper\n"
        "@dataclass\nclass Note:\n    k: int\n"
        "class Late(Eavesdropper):\n    name = 'late'\n"
        "    def observe(self, t): ...\n    def belief(self): ...\n"
    )
    assert named(f"{file}:Late").name == "late"
