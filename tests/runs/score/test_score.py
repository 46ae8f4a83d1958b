"""The scoring and the report: right numbers, honest intervals, words that match them."""

import base64
import json
import math
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from protocol.statistics import NO_RUNS, Interval, stated_left
from runtime.run_folder import BELIEFS, GUESSES
from tap_service.eavesdroppers.base import KEPT_MESSAGES, KEPT_SYMBOLS, Belief
from tests.support import traced
from wyner.drawing.secrecy import draw_report
from wyner.drawing.style import svg_of
from wyner.runs.run import Run
from wyner.runs.score import words
from wyner.runs.score.report import Report, TapReport, percent, report
from wyner.runs.score.score import (
    DEAF,
    SILENT,
    UNFINISHED,
    EavesdropperScore,
    Proportion,
    RunScore,
    ScoreError,
    TapOutput,
    Truth,
    read_truth,
    score,
    score_run,
)

S = "0" * 16


def truth(n: int = 10, *, whole: bool = True) -> Truth:
    keys = {(S, 2 * k): k % 2 for k in range(n)}
    symbols = {(S, 2 * k + 1): 1 - k % 2 for k in range(n)}
    return Truth(2, keys, symbols, ((2 * n, b"word"),) if whole else (), 2 * n)


def said(right: int, n: int = 10, *, whole: bool = False, name: str = "tap") -> TapOutput:
    t = truth(n)
    live = {at: v if i < right else 1 - v for i, (at, v) in enumerate(t.keys.items())}
    symbols = {k: v if i < right else 1 - v for i, ((_, k), v) in enumerate(t.symbols.items())}
    found = (b"word",) if whole else ()
    solved_k = 20 if whole else -1
    belief = Belief(b"word", found, len(found), 0.5, 7, solved_k)
    return TapOutput(name, S, live, {}, belief, tuple(symbols.items()))


def left(tap: TapReport | None) -> Interval:
    """Bits that an eavesdropper leaves, who is scored."""
    assert tap is not None
    assert tap.left_bits is not None
    return tap.left_bits


def one_run(t: Truth, *scores: EavesdropperScore) -> Report:
    return report([RunScore("r", t, scores)])


def believing(one: TapOutput, symbols: dict[int, int]) -> TapOutput:
    return replace(one, message_symbols=tuple(symbols.items()))


def test_a_score_counts_keys_bits_and_messages() -> None:
    s = score(truth(), said(7, whole=True))
    assert (s.keys.right, s.keys.of) == (7, 10)
    assert (s.bits.right, s.bits.of) == (7, 10)
    assert (s.messages.right, s.messages.of) == (1, 1)
    assert s.why_unscored == ""


def test_second_thoughts_count_for_secrecy_and_first_ones_stay() -> None:
    first = said(5)
    s = score(truth(), replace(first, reviewed=truth().keys))
    assert s.keys.share == 0.5
    assert s.keys_reviewed.share == 1.0


def test_a_missed_bit_is_a_blind_guess() -> None:
    t = truth()
    ends = {at: t.keys[at] for at in ((S, 0), (S, 18))}  # she said something first and last
    s = score(t, TapOutput("tap", S, ends, {}, Belief()))
    assert s.bits == Proportion(5, 10)
    once = believing(said(10), {19: truth().symbols[S, 19]})
    assert score(truth(), once).bits == Proportion(1 + 9 / 2, 10)


def test_only_what_she_no_longer_keeps_is_left_out_of_the_bits() -> None:
    n = KEPT_SYMBOLS + 5
    t = truth(n)
    kept = {k: v for (_, k), v in list(t.symbols.items())[5:]}
    assert score(t, believing(said(0), kept)).bits == Proportion(KEPT_SYMBOLS, KEPT_SYMBOLS)
    kept.pop(2 * n - 1)
    assert score(t, believing(said(0), kept)).bits == Proportion(n - 6 + 6 / 2, n)


@pytest.mark.parametrize("stated", [None, 638.0])
def test_a_tap_that_was_deaf_for_most_of_a_run_keeps_no_secret(stated: float | None) -> None:
    """One stray message, and of 320 steps she used 30: "638 bits left" stood where 0 were left.

    Steps that she could not use are silence of the tap: neither hers nor a secret.
    """
    t = truth(320)
    whole = said(320, 320)
    believed = replace(whole.belief, bits_left=stated)
    deaf = replace(whole, live={at: v for at, v in whole.live.items() if at[1] < 60})
    s = score(t, replace(deaf, belief=believed))
    assert (s.keys, s.silent) == (Proportion(30, 30), 290)
    r = one_run(t, s)
    (tap,) = r.taps
    assert (tap.silent_steps, tap.silent_bits) == (290, 290.0)
    assert left(tap).high < 10.0
    assert "of the 30 that it could use" in r.verdict()
    assert "and of 290 bits nobody knows" in r.verdict()
    assert any(line.startswith("could not use 290 of 320") for line in words.remarks(tap))
    told = r.to_json()["taps"]["tap"]
    assert (told["silent_steps"], told["silent_bits"]) == (290, 290.0)
    # one who heard all and knows less is the stronger one: more is known of her
    half = score(t, said(250, 320, name="half"))
    both = one_run(t, s, half)
    assert both.strongest is both.taps[1]
    nothing = score(t, replace(deaf, live={(S, 1): 0}, belief=believed))
    assert nothing.why_unscored == DEAF
    assert one_run(t, nothing).strongest is None


def test_steps_of_which_a_tap_lacked_a_message_are_silence_and_not_secrets() -> None:
    whole = said(10)
    holes = {at for at in whole.live if at[1] >= 8}
    s = score(truth(), replace(whole, holes=holes))
    assert (s.keys, s.silent) == (Proportion(4, 4), 6)


def mirrored(keys: int, wrong: int, size: int = 2) -> tuple[Truth, TapOutput]:
    """One who names each symbol by another's name, and is wrong ``wrong`` times even so."""
    draw = random.Random(keys)
    t = Truth(size, {(S, 2 * k): draw.randrange(size) for k in range(keys)}, {}, (), 2 * keys)
    names = [(symbol + 1) % size for symbol in range(size)]
    live = {}
    for i, (at, key) in enumerate(t.keys.items()):
        live[at] = names[(key + 1) % size if i < wrong else key]
    return t, TapOutput("mirror", S, live, {}, Belief())


@pytest.mark.parametrize(("size", "keys"), [(2, 1277), (3, 400), (4, 400), (16, 400)])
def test_what_she_knows_counts_and_not_how_she_names_it(size: int, keys: int) -> None:
    """Wrong 99.8 % of the time with M = 2 read "no better than chance, leaves 1277 bits"."""
    t, one = mirrored(keys, 3, size)
    s = score(t, one)
    assert s.keys.right <= 3
    assert (s.known.named, s.known.right, s.known.of) == (s.keys.right, keys - 3, keys)
    assert RunScore("r", t, (s,)).to_json()["mirror"]["symbols_known"] == (keys - 3) / keys
    r = one_run(t, s)
    (tap,) = r.taps
    assert r.exceeds
    assert "PAPER'S RULE EXCEEDS TRUE" in r.verdict()
    assert (
        tap.guessing_probability.low
        < tap.guessing_probability.value
        == (keys - 3) / keys
        < tap.guessing_probability.high
    )
    assert left(tap).high < 0.2 * r.claimed_bits
    assert tap.symbol_error_rate.value > 0.99  # as she names them
    assert any("relabelled" in line for line in words.remarks(tap))
    # each run has a labelling of its own, as each run's model may be mirrored or not
    straight = replace(one, live=dict(t.keys))
    both = report([RunScore("r", t, (s,)), RunScore("s", t, (score(t, straight),))])
    assert both.taps[0].guessing_probability.value == (2 * keys - 3) / (2 * keys)
    assert both.exceeds


def test_messages_are_compared_with_as_many_of_the_last_as_she_keeps() -> None:
    recovered = tuple((k, b"%d" % k) for k in range(71))
    t = Truth(2, {}, {}, recovered, 71)
    whole = tuple(p for _, p in recovered[-KEPT_MESSAGES:])
    s = TapOutput("tap", S, {}, {}, Belief(whole=whole, whole_count=71, solved_k=5))
    assert score(t, s).messages == Proportion(KEPT_MESSAGES, KEPT_MESSAGES)
    few = replace(s, belief=replace(s.belief, whole_count=len(whole)))
    assert score(t, few).messages == Proportion(KEPT_MESSAGES, 71)


def test_a_wrong_message_counts_for_nothing_and_one_twice_for_one() -> None:
    t = Truth(2, {}, {}, ((5, b"a"), (9, b"a"), (12, b"b")), 20)
    s = TapOutput("tap", S, {}, {}, Belief(whole=(b"a", b"x", b"b"), whole_count=3, solved_k=5))
    assert score(t, s).messages == Proportion(2, 3)


def run_score(right: int, *, whole: bool = False, name: str = "tap", run: str = "r") -> RunScore:
    return RunScore(run, truth(), (score(truth(), said(right, whole=whole, name=name)),))


def test_the_report_pools_runs() -> None:
    r = report([run_score(5), run_score(10, whole=True)])
    (t,) = r.taps
    assert r.claimed_bits == 20
    assert t.symbol_error_rate.value == pytest.approx(0.25)
    assert t.exact_message_rate.value == 0.5
    assert not t.exact_message_rate.known  # two runs have no interval over runs, and say so
    assert percent(t.exact_message_rate) == "50.0 % (no interval)"
    assert t.guessing_probability.value == 0.75
    assert left(t).value == pytest.approx(10 * -math.log2(0.75))  # nothing of the broken run's
    assert left(t).high == 10  # 15 of 20 may be chance, as often as one looks
    assert t.broken_at_k == (-1, 20)
    assert t.median_broken == 20
    assert r.hidden_bits == pytest.approx(math.log2(41))


def test_more_than_true_is_said_in_words_and_of_the_rule_not_of_the_paper() -> None:
    broken = report([run_score(10, whole=True)])
    assert broken.exceeds
    assert (
        "PAPER'S RULE EXCEEDS TRUE: by the paper's rule 10 bits count as secret; tap leaves at "
        "most 0.0 of them" in broken.verdict()
    )
    blind = report([run_score(5)])
    assert not blind.exceeds
    assert "EXCEEDS" not in blind.verdict()
    assert "tap leaves at most 10.0 of them, no better than chance" in blind.verdict()
    nothing = RunScore("r", Truth(2, {}, {}, (), 50), ())
    assert "No key was agreed by the paper's rule" in report([nothing]).verdict()


def test_a_report_in_which_nothing_counts_and_nobody_is_scored_is_drawn() -> None:
    """The page of a sealed run came with a warning that there was no room for its figure."""
    t = Truth(2, {}, {}, (), 50)
    taps = (score(t, replace(said(0, name=f"tap {i}"), live={})) for i in range(5))
    r = one_run(t, *taps)
    assert b"<svg" in svg_of((7.6, 2.0), lambda axes: draw_report(axes, r))


def test_one_who_fails_or_does_not_guess_is_not_scored_and_never_the_strongest() -> None:
    """A tap that raised at step 21 ended as "True: 77, measured"; one for keys left "3198.0"."""
    t = truth()
    failed = score(t, replace(said(10), failed="step 21: ValueError: no idea", heard_out=False))
    keys = score(t, replace(said(0, name="key-solver"), live={}))
    weak = score(t, said(5, name="weak"))
    assert failed.keys.share is failed.bits.share is None
    r = one_run(t, failed, keys)
    assert r.strongest is None
    assert r.unscored == {
        "tap": "it failed: step 21: ValueError: no idea",
        "key-solver": SILENT,
    }
    assert "; tap: it failed: step 21: ValueError: no idea, so they" in r.verdict()
    only_keys = one_run(t, keys)
    assert "10 bits count as secret; nobody guessed, so they stand untested" in only_keys.verdict()
    value = only_keys.to_json()["taps"]["key-solver"]
    assert value["left_bits"] is None
    assert value["symbol_error_rate"]["value"] is None
    assert value["symbol_error_rate"]["no_interval"]
    assert words.guess_rows(only_keys.taps)[0][1:3] == ("-", "-")
    assert words.secrecy_rows(only_keys.taps)[0][1:4] == ("-", "-", "-")
    with_weak = one_run(t, failed, weak)
    assert with_weak.strongest is with_weak.taps[1]
    # in one of two runs she failed: what she would have left of that one nobody knows
    twice = report([RunScore("r", t, (failed,)), run_score(10)])
    assert twice.strongest is None
    assert twice.taps[0].unscored.endswith("(in 1 of 2 runs)")


def test_what_she_had_before_she_failed_counts() -> None:
    before = replace(said(10, whole=True), failed="step 25: ValueError: late", heard_out=False)
    r = one_run(truth(), score(truth(), before))
    assert r.exceeds
    assert left(r.strongest) == (0.0, 0.0, 0.0)


def test_one_who_did_not_finish_is_called_so_and_another_leads() -> None:
    stopped = replace(said(10), heard_out=False, belief=replace(said(10).belief, bits_left=44.0))
    weak = said(5, name="weak")
    r = one_run(truth(), score(truth(), stopped), score(truth(), weak))
    assert r.strongest is r.taps[1]
    assert r.taps[0].unscored == UNFINISHED
    alone = one_run(truth(), score(truth(), stopped))
    assert UNFINISHED in alone.verdict(), "nobody may say that she guessed nothing"


def test_bits_left_by_her_own_account_stand_in_place_of_her_guesses() -> None:
    one = said(5)
    believed = replace(one.belief, bits_left=3.25, given="English sentences")
    told = score(truth(), replace(one, belief=believed))
    r = one_run(truth(), told, score(truth(), said(5, name="weak")))
    assert r.strongest is r.taps[0]
    assert left(r.strongest) == stated_left(3.25, 10.0)
    high = stated_left(3.25, 10.0).high
    accounts = f"({high:.1f} given English sentences, by keys alone 10.0)"
    assert accounts in r.verdict()
    (remark,) = words.remarks(r.strongest)
    assert "bits left, given English sentences; by its keys" in remark
    assert left(r.strongest)[:2] == (3.25, 0.0)
    assert left(r.strongest).high > 3.25
    assert not r.exceeds  # her word is no proof: nothing of hers was right beyond chance
    more = score(truth(), replace(one, belief=replace(one.belief, bits_left=1651.9)))
    r = one_run(truth(), more)
    assert left(r.strongest).high == 10.0, "no more than the agreed keys are left"


@pytest.mark.parametrize("size", [2, 4, 16])
@pytest.mark.parametrize("keys", [50, 230])
def test_a_blind_tap_leaves_all(keys: int, size: int) -> None:
    """The share that was right by chance took 3.6 % of 230 keys off, 7.5 % of 50; so would the
    best of 16! labellings, were its choice for free: it is right at 18 % of 230.
    """
    draw = random.Random(3)
    t = Truth(size, {(S, k): draw.randrange(size) for k in range(keys)}, {}, (), keys)
    lucky = 0
    for _ in range(40):
        live = {at: draw.randrange(size) for at in t.keys}
        r = one_run(t, score(t, TapOutput("blind", S, live, {}, Belief())))
        assert not r.taps[0].relabelled
        assert r.exceeds == (left(r.strongest).high < keys * math.log2(size) - 1e-9)
        lucky += r.exceeds
    assert lucky <= (size > 2)


def test_nothing_is_known_of_a_run_in_which_she_did_not_listen() -> None:
    """One who broke the only run she heard was said to leave nothing of the other's keys."""
    t = truth(400)
    heard = score(t, said(400, 400, whole=True, name="late"))
    good = score(t, said(400, 400, name="always"))
    r = report([RunScore("one", t, (good,)), RunScore("two", t, (good, heard))])
    always, late = r.taps
    assert r.claimed_bits == 800
    assert (left(late).low, left(late).high, late.silent_bits) == (0, 0, 400)
    assert left(always).high < 40
    assert r.strongest is always
    assert "always leaves at most" in r.verdict()


PRINTED = {
    "runs", "agreed_steps", "symbol_error_rate", "symbol_error_rate_live",
    "message_bit_error_rate", "exact_message_rate", "guessing_probability", "min_entropy_bits",
    "relabelled", "left_bits", "left_bits_by_keys", "left_bits_stated", "given", "silent_bits",
    "silent_steps", "unused", "unscored", "list_size", "list_size_log2", "broken_at_k", "keys",
}  # fmt: skip


def test_what_is_printed_for_machines_keeps_its_names() -> None:
    value = json.loads(json.dumps(report([run_score(7), run_score(9, whole=True)]).to_json()))
    assert set(value["taps"]["tap"]) == PRINTED
    assert value["taps"]["tap"]["symbol_error_rate"] == {
        "value": pytest.approx(0.2), "low": None, "high": None, "no_interval": NO_RUNS,
    }  # fmt: skip
    assert value["taps"]["tap"]["list_size_log2"] == pytest.approx(math.log2(7))


# --- from files ----------------------------------------------------------------------------------


def guessed_run(run_dir: Path) -> None:
    def transition(k: int, role: str, symbol: int, bit: int) -> dict[str, Any]:
        return traced.transition(S, k, k, role=role, symbol=symbol, message_symbol=bit)

    plant = [
        traced.session(S),
        transition(0, "test", 0, -1),
        transition(1, "message", -1, 1),
        transition(2, "test", 1, -1),  # the last one's result never travelled
        {"event": "recovered", "payload": base64.b64encode(b"m").decode()},
    ]
    traced.write_run(run_dir, "sustained", plant=plant)
    (run_dir / "tap").mkdir()
    guess = {"event": "guess", "name": "t", "session": S, "k": 0, "symbol": 0, "p": 1, "agreed": 1}
    (run_dir / GUESSES).write_text(json.dumps(guess) + '\n{"torn')
    record = {
        "name": "t", "session": S, "failed": "", "message": "bQ==", "whole": ["bQ=="],
        "whole_count": 1, "candidates_left": 1, "solved_k": 2, "confidence": 1.0,
        "symbols": [[1, 1]],
    }  # fmt: skip
    (run_dir / BELIEFS).write_text(json.dumps({"t": record}))


def test_a_run_is_scored_from_its_files(tmp_path: Path) -> None:
    guessed_run(tmp_path)
    t = read_truth(Run.load(tmp_path))
    assert t.keys == {(S, 0): 0}
    assert t.symbols == {(S, 1): 1}
    assert t.whole == ((2, b"m"),)
    assert t.transitions == 3
    summary = score_run(Run.load(tmp_path)).to_json()["t"]
    assert summary["symbol_accuracy"] == 1.0
    assert summary["message_bit_accuracy"] == 1.0
    assert summary["messages_exact"] == 1
    assert summary["guessed_text"] == "m"


def test_a_tap_that_was_killed_has_keys_and_no_bits(tmp_path: Path) -> None:
    guessed_run(tmp_path)
    beliefs = json.loads((tmp_path / BELIEFS).read_text())
    beliefs["t"]["symbols"] = None  # as they stand before the end
    (tmp_path / BELIEFS).write_text(json.dumps(beliefs))
    run = score_run(Run.load(tmp_path))
    assert run.to_json()["t"]["symbol_accuracy"] == 1.0
    assert run.to_json()["t"]["message_bit_accuracy"] is None
    assert words.guess_rows(report([run]).taps)[0][2] == "-"


def test_missing_files_are_one_line(tmp_path: Path) -> None:
    for expected in ("plant/trace.jsonl: cannot be read", "beliefs.json: cannot be read"):
        with pytest.raises(ScoreError, match=expected) as error:
            score_run(Run.load(tmp_path))
        assert "\n" not in str(error.value)
        traced.write_run(tmp_path, "sustained", plant=())
