"""The scoring and the report: right numbers, honest intervals, words that match them."""

import base64
import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.trace import PLANT_TRACE, TraceWriter
from tap_service import report as reporting
from tap_service.analysis import BELIEFS, GUESSES
from tap_service.report import Share, report
from tap_service.secrecy import (
    Proportion,
    RunScore,
    Said,
    ScoreError,
    Truth,
    read_truth,
    score,
    score_run,
    summary_of,
)

S = "0" * 16


def truth(n: int = 10, *, whole: bool = True) -> Truth:
    keys = {(S, 2 * k): k % 2 for k in range(n)}
    symbols = {(S, 2 * k + 1): 1 - k % 2 for k in range(n)}
    return Truth(2, keys, symbols, ((2 * n, b"word"),) if whole else (), 2 * n)


def said(right: int, n: int = 10, *, whole: bool = False, name: str = "tap") -> Said:
    t = truth(n)
    live = {at: v if i < right else 1 - v for i, (at, v) in enumerate(t.keys.items())}
    symbols = {k: v if i < right else 1 - v for i, ((_, k), v) in enumerate(t.symbols.items())}
    found = (b"word",) if whole else ()
    return Said(name, live, {}, S, symbols, b"word", found, 7, 20 if whole else -1, 0.5)


def test_wilson_against_published_values() -> None:
    # Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29
    for right, of, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605)):
        assert Proportion(right, of).interval == pytest.approx((low, high), abs=5e-5)
    assert Proportion(0, 20).interval == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert Proportion(1, 29).interval == pytest.approx((0.0061, 0.1718), abs=5e-5)


@given(st.integers(0, 50), st.integers(1, 50))
def test_an_interval_holds_its_share_and_stays_in_range(right: int, of: int) -> None:
    p = Proportion(min(right, of), of)
    low, high = p.interval
    assert p.share is not None
    assert 0 <= low <= p.share <= high <= 1


def test_of_no_trials_nothing_is_said() -> None:
    assert Proportion(0, 0).share is None
    assert Proportion(0, 0).interval == (0.0, 1.0)
    assert Share.over([]).text() == "-"


def test_a_score_counts_keys_bits_and_messages() -> None:
    s = score(truth(), said(7, whole=True))
    assert (s.keys.right, s.keys.of) == (7, 10)
    assert (s.bits.right, s.bits.of) == (7, 10)
    assert (s.messages.right, s.messages.of) == (1, 1)
    assert s.guessing == 0.7
    assert s.left_bits_per_key == pytest.approx(-math.log2(0.7))


def test_second_thoughts_count_for_secrecy_and_first_ones_stay() -> None:
    first = said(5)
    better = Said(**{f: getattr(first, f) for f in Said.__slots__} | {"reviewed": truth().keys})
    s = score(truth(), better)
    assert s.keys.share == 0.5
    assert s.keys_reviewed.share == 1.0
    assert s.guessing == 1.0


def test_a_missed_bit_is_a_blind_guess() -> None:
    silent = Said("tap", {}, {}, S, {}, b"", (), 0, -1, 0.0)
    s = score(truth(), silent)
    assert s.bits.share == 0.5
    assert s.guessing == 0.5  # never below a blind guess


def test_a_wrong_message_counts_for_nothing_and_one_twice_for_one() -> None:
    t = Truth(2, {}, {}, ((5, b"a"), (9, b"a"), (12, b"b")), 20)
    s = Said("tap", {}, {}, S, {}, b"", (b"a", b"x", b"b"), 0, 5, 1.0)
    assert score(t, s).messages == Proportion(2, 3)


def run_score(right: int, *, whole: bool = False, name: str = "tap", run: str = "r") -> RunScore:
    return RunScore(run, truth(), (score(truth(), said(right, whole=whole, name=name)),))


def test_the_report_pools_runs() -> None:
    r = report([run_score(5), run_score(10, whole=True)])
    (t,) = r.taps
    assert r.claimed_bits == 20
    assert t.symbol_errors.value == pytest.approx(0.25)
    assert t.exact.value == 0.5
    assert t.guessing == 0.75
    assert t.left_bits == pytest.approx(10 * -math.log2(0.75))  # nothing of the broken run's
    assert t.broken_k == (-1, 20)
    assert t.median_broken == 20
    assert r.hidden_bits == pytest.approx(2 * math.log2(21))


def test_claimed_above_true_is_said_in_words() -> None:
    broken = report([run_score(10, whole=True)])
    assert broken.exceeds
    assert "CLAIMED EXCEEDS TRUE: 10 secret bits are claimed, tap leaves 0.0" in broken.verdict()
    blind = report([run_score(5)])
    assert not blind.exceeds
    assert "EXCEEDS" not in blind.verdict()
    nothing = RunScore("r", Truth(2, {}, {}, (), 50), ())
    assert "No key was agreed" in report([nothing]).verdict()


def test_the_strongest_is_the_one_who_leaves_least() -> None:
    scores = (score(truth(), said(10, whole=w, name=n)) for n, w in (("a", False), ("b", True)))
    r = report([RunScore("r", truth(), tuple(scores))])
    assert r.strongest is not None
    assert r.strongest.name == "b"


def test_intervals_over_runs_are_wider_than_over_steps_when_runs_differ() -> None:
    parts = [Proportion(100, 100)] * 5 + [Proportion(50, 100)] * 5
    share = Share.over(parts)
    low, high = Proportion(750, 1000).interval
    assert share.high - share.low > 2 * (high - low)
    assert share == Share.over(parts)  # the same twice


def test_json_and_rows_hold_every_figure() -> None:
    r = report([run_score(7), run_score(9, whole=True)])
    value = json.loads(json.dumps(reporting.as_json(r)))
    tap = value["taps"]["tap"]
    assert tap["symbol_error_rate"]["of"] == 20
    assert tap["list_size_log2"] == pytest.approx(math.log2(7))
    assert value["claimed_bits"] == 20
    assert "H(model | transcript)" in value["bound"]
    (row,) = reporting.rows(r)
    assert len(row) == len(reporting.HEADINGS)


# --- from files ----------------------------------------------------------------------------------


def transition(k: int, role: str, symbol: int, bit: int) -> dict[str, object]:
    return {
        "event": "transition", "session": S, "k": k, "candidates": [[0.0], [1.0]],
        "role": role, "symbol": symbol, "message_symbol": bit,
    }  # fmt: skip


def write_run(run_dir: Path) -> None:
    trace = TraceWriter(run_dir / PLANT_TRACE, "plant", {})
    trace.write(transition(0, "test", 1, -1))
    trace.write(transition(0, "test", 0, -1))  # written again after a crash: the last counts
    trace.write(transition(1, "message", -1, 1))
    trace.write(transition(2, "test", 1, -1))  # the last one's result never travelled
    trace.write({"event": "recovered", "payload": base64.b64encode(b"m").decode()})
    trace.close()
    (run_dir / "tap").mkdir()
    guess = {"event": "guess", "name": "t", "session": S, "k": 0, "symbol": 0, "p": 1, "agreed": 1}
    (run_dir / GUESSES).write_text(json.dumps(guess) + '\n{"torn')
    record = {
        "name": "t", "session": S, "failed": "", "message": "bQ==", "whole": ["bQ=="],
        "candidates_left": 1, "solved_k": 2, "confidence": 1.0, "symbols": [[1, 1]],
    }  # fmt: skip
    (run_dir / BELIEFS).write_text(json.dumps({"t": record}))


def test_a_run_is_scored_from_its_files(tmp_path: Path) -> None:
    write_run(tmp_path)
    t = read_truth(tmp_path)
    assert t.keys == {(S, 0): 0}
    assert t.symbols == {(S, 1): 1}
    assert t.whole == ((2, b"m"),)
    assert t.transitions == 3
    summary = summary_of(score_run(tmp_path))["t"]
    assert summary["symbol_accuracy"] == 1.0
    assert summary["message_bit_accuracy"] == 1.0
    assert summary["messages_exact"] == 1
    assert summary["guessed_text"] == "m"


def test_missing_files_are_one_line(tmp_path: Path) -> None:
    for expected in ("plant/trace.jsonl: cannot be read", "beliefs.json: cannot be read"):
        with pytest.raises(ScoreError, match=expected) as error:
            score_run(tmp_path)
        assert "\n" not in str(error.value)
        TraceWriter(tmp_path / PLANT_TRACE, "plant", {}).close()


# --- the page ------------------------------------------------------------------------------------


@pytest.mark.parametrize("study", ["ladder", "learning", "view"])
def test_the_page_shows_the_tables_of_its_data(study: str) -> None:
    from experiments.secrecy.tables import PAGE, in_markdown, read_rows

    assert read_rows(study)
    assert in_markdown(study) in PAGE.read_text(encoding="utf-8")


def test_a_row_of_the_data_comes_out_again() -> None:
    from experiments.secrecy.study import measure, tasks
    from experiments.secrecy.tables import read_rows

    rows = {row["task"]: row for study in ("ladder", "alpha") for row in read_rows(study)}
    again = [t for t in tasks(100) if t.id in rows][7:240:40]
    assert len(again) > 4
    for task in again:
        row = {name: str(value) for name, value in measure(task).items()}
        assert row | {"version": ""} == rows[task.id] | {"version": ""}


def test_measuring_adds_the_rows_that_are_missing_and_no_others(tmp_path: Path) -> None:
    from experiments.secrecy.tables import DATA
    from experiments.studies import MEASUREMENTS

    whole = (DATA / "secrecy-alpha.csv").read_text(encoding="utf-8").splitlines()
    path = tmp_path / "secrecy-alpha.csv"
    torn = whole[-2][:30]  # as a kill leaves it
    path.write_text("\n".join([*whole[:-2], torn]), encoding="utf-8")
    for _ in range(2):
        MEASUREMENTS["secrecy-alpha"](path)
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[:-2] == whole[:-2]
        for line, shipped in zip(lines[-2:], whole[-2:], strict=True):
            task, _, *measured = line.split(",")
            assert [task, *measured] == shipped.split(",")[:1] + shipped.split(",")[2:]
