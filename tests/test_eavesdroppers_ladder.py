"""The ladder on seeded runs: what each must get, and the controls that must fail."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.secrecy.runs import Run, simulate, text_of
from experiments.secrecy.study import ALPHAS, heard_by, knowledge_for, said_about
from protocol.knowledge import Knowledge
from tap_service.eavesdroppers import KnowledgeError, named
from tap_service.eavesdroppers.interface import Eavesdropper
from tap_service.eavesdroppers.list_decoder import ListDecoder
from tap_service.secrecy import Said, TapScore, score
from tap_service.status import Listener
from tap_service.view import View

CLEAR = View()


def play(run: Run, name: str, view: View = CLEAR) -> tuple[Said, TapScore]:
    kind = named(name)
    said = said_about(kind(knowledge_for(run, kind, view)), heard_by(run, view))
    return said, score(run.truth, said)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(ALPHAS), st.integers(0, 10**6))
def test_nearest_centre_is_never_wrong_on_an_agreed_step(alpha: float, seed: int) -> None:
    run = simulate(150, seed, alpha=alpha)
    _, scored = play(run, "nearest-centre")
    assert scored.keys.right == scored.keys.of


@pytest.mark.parametrize("name", ["paper", "quadruple-tank"])
def test_nearest_centre_on_other_systems(name: str) -> None:
    run = simulate(60, 1, name=name, alpha=8.0)
    _, scored = play(run, "nearest-centre")
    assert scored.keys.of > 0
    assert scored.keys.right == scored.keys.of


def test_set_membership_guesses_blindly_on_agreed_steps() -> None:
    scores = [play(simulate(1000, seed), "set-membership")[1] for seed in range(4)]
    keys = scores[0].keys
    for s in scores[1:]:
        keys = keys.plus(s.keys)
    low, high = keys.interval
    assert low < 0.5 < high


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["list-decoder", "oracle"])
def test_the_framed_message_is_had_when_the_plant_has_it(name: str, seed: int) -> None:
    run = simulate(1000, seed)
    said, scored = play(run, name)
    assert run.truth.whole
    assert said.whole == tuple(p for _, p in run.truth.whole)
    assert said.solved_k == run.truth.whole[0][0]
    assert scored.bits.right == scored.bits.of


def test_several_messages_come_in_order() -> None:
    payloads = [b"one", b"two", b"three"]
    run = simulate(1300, 7, payloads=payloads)
    assert len(run.truth.whole) == 3
    for name in ("list-decoder", "oracle"):
        assert play(run, name)[0].whole == tuple(payloads)


def test_raw_english_without_a_frame_check() -> None:
    import random

    exact = 0
    for seed in range(8):
        rng = random.Random(f"raw text {seed}")
        run = simulate(1000, seed, payloads=[text_of(rng) for _ in range(3)], raw=True)
        tap = ListDecoder(run.scenario.knowledge(), framed=False)
        said = said_about(tap, heard_by(run, CLEAR))
        exact += said.message == b" ".join(run.payloads)[: len(run.stream) // 8]
    assert exact >= 6  # at a true rate of 80 % a run of eight does worse once in twenty


@pytest.mark.slow
def test_the_learner_starts_from_nothing() -> None:
    exact = right = of = 0
    for seed in range(3):
        run = simulate(1200, seed)
        said, scored = play(run, "learning")
        exact += said.whole == tuple(p for _, p in run.truth.whole)
        early = {at: v for at, v in run.truth.keys.items() if at[1] < 200}
        right += sum(said.reviewed.get(at) == v for at, v in early.items())
        of += len(early)
        assert scored.keys_reviewed.right >= 0.99 * scored.keys_reviewed.of
    assert exact >= 2
    assert right >= 0.95 * of


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.1, 0.3, 0.5])
def test_the_learner_starts_from_a_wrong_model(error: float) -> None:
    exact = 0
    for seed in range(2):
        run = simulate(1200, 100 + seed)
        said, _ = play(run, "learning", View(model_error=error, seed=seed))
        exact += said.whole == tuple(p for _, p in run.truth.whole)
    assert exact >= 1


@pytest.mark.slow
def test_the_smoother_gains_over_the_list_decoder_when_messages_are_lost() -> None:
    for loss in (0.1, 0.3):
        view = View(loss=loss, seed=3)
        run = simulate(1000, 3)
        plain, smooth = (play(run, name, view)[1] for name in ("list-decoder", "smoother"))
        assert smooth.keys_reviewed.right > plain.keys_reviewed.right
        blind = 0.5 * smooth.keys.of
        assert smooth.keys_reviewed.right - blind > 1.15 * (plain.keys_reviewed.right - blind)


def test_the_smoother_is_the_list_decoder_on_a_clear_view() -> None:
    run = simulate(900, 2)
    said, scored = play(run, "smoother")
    assert said.whole == tuple(p for _, p in run.truth.whole) != ()
    assert scored.bits.right == scored.bits.of


# --- negative controls ---------------------------------------------------------------------------


def test_alpha_one_agrees_no_key() -> None:
    assert not simulate(1000, 1, alpha=1.0).truth.keys


def test_the_oracle_on_a_clear_view_guesses_every_key() -> None:
    _, scored = play(simulate(1000, 5), "oracle")
    assert scored.guessing == 1.0
    assert scored.left_bits_per_key == 0.0


@pytest.mark.parametrize("name", ["set-membership", "nearest-centre", "list-decoder", "smoother"])
def test_who_sees_nothing_guesses_like_a_coin(name: str) -> None:
    run = simulate(300, 6)
    kind = named(name)
    heard = heard_by(run, View(loss=1.0))
    assert heard == []
    said = said_about(kind(knowledge_for(run, kind, CLEAR)), heard)
    scored = score(run.truth, said)
    assert scored.guessing == 0.5
    assert scored.left_bits_per_key == 1.0
    assert not said.whole


@pytest.mark.parametrize("name", ["oracle", "list-decoder", "learning"])
def test_a_corrupted_key_is_refused_by_the_frame_check(name: str) -> None:
    run = simulate(1000, 8, corrupt=60)
    assert not run.truth.whole
    assert play(run, name)[0].whole == ()


# --- the interface -------------------------------------------------------------------------------


def test_the_documented_eavesdropper_runs(tmp_path: Path) -> None:
    text = (Path(__file__).parent.parent / "docs" / "eavesdroppers.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(code.splitlines()) <= 40
    file = tmp_path / "mine.py"
    file.write_text(code)
    kind = named(f"{file}:Momentum")
    run = simulate(300, 1)
    said = said_about(kind(run.scenario.knowledge()), heard_by(run, View(loss=0.05)))
    scored = score(run.truth, said)
    assert scored.keys.of > 30
    assert 0.2 < (scored.keys.share or 0) < 1.0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nobody", "expected set-membership"),
        ("missing.py:Tap", "expected an existing Python file"),
        ("{file}:Absent", "expected a class Absent"),
        ("{file}:Nameless", "expected a class attribute name"),
        ("{broken}:Tap", "cannot be loaded: ZeroDivisionError"),
    ],
)
def test_a_wrong_name_is_one_line(tmp_path: Path, name: str, expected: str) -> None:
    file, broken = tmp_path / "mine.py", tmp_path / "broken.py"
    file.write_text(
        "from tap_service.eavesdroppers import Eavesdropper\nclass Nameless(Eavesdropper): pass\n"
    )
    broken.write_text("1 / 0\n")
    with pytest.raises(KnowledgeError, match=expected) as error:
        named(name.format(file=file, broken=broken))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["set-membership", "nearest-centre", "list-decoder", "smoother", "oracle"]
)
def test_one_who_needs_a_model_says_what_she_lacks(name: str) -> None:
    with pytest.raises(KnowledgeError, match=f"eavesdropper {name}: knowledge lacks A, B"):
        named(name)(Knowledge(scenario="s", period_s=0.1, candidates=2))


def test_the_oracle_needs_alpha() -> None:
    run = simulate(1, 0)
    with pytest.raises(KnowledgeError, match="lacks alpha"):
        named("oracle")(run.scenario.knowledge())


def test_one_who_fails_stops_alone() -> None:
    class Broken(Eavesdropper):
        name = "broken"

        def observe(self, transition):  # type: ignore[no-untyped-def]
            raise RuntimeError("no idea")

        def belief(self):  # type: ignore[no-untyped-def]
            raise AssertionError("not asked any more")

    run = simulate(3, 0)
    listener = Listener(Broken(run.scenario.knowledge()), "broken")
    for transition in heard_by(run, CLEAR):
        assert listener.observe(transition) is None
    assert listener.failed.startswith("step 0: RuntimeError: no idea")
    assert listener.belief().message == b""
    assert listener.review() == ()
