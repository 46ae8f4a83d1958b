"""The benchmark of keys: the shape and the arithmetic of its result, never its speed."""

import random

import pytest

from benchmarks.keys import CASES, KeyRound, delay, in_distillation, key_round, measure, render


def test_offers_between_a_blocks_end_and_its_storing_are_those_of_a_distillation() -> None:
    lines = [{"event": "transition", "j": j, "k": j + 100} for j in range(6)]
    lines.insert(6, {"event": "block", "number": 0})  # after the transition 5
    lines.append({"event": "end", "k": 0})
    assert in_distillation(lines, lambda b: 3 + 10 * b) == {104, 105, 106}


@pytest.mark.long
@pytest.mark.integration
def test_a_round_with_keys_is_measured() -> None:
    once = key_round("on", steps=400, pace="fast")
    assert once.steps_per_second > 0
    assert not once.offers_us["off"]
    assert len(once.offers_us["on"]) + len(once.offers_us["distilling"]) > 200


def test_the_result_is_of_medians_and_of_all_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds = iter([100.0, 50.0, 300.0])
    factor = {"off": 1.0, "on": 0.5}
    turns = {"ratio": 0.8, "low": 0.75, "high": 0.85}
    calls: list[tuple[str, str]] = []

    def fake(loop: str, *, steps: int, pace: str) -> KeyRound:
        calls.append((pace, loop))
        of_round = [c for c in calls if c[0] == "fast"]
        if pace == "fast" and len(of_round) % 2 == 1:
            speed.append(next(speeds))
        offers: dict[str, list[float]] = {case: [] for case in CASES}
        offers["off" if loop == "off" else "on"] = [1.0, 2.0, 3.0]
        return KeyRound(factor[loop] * speed[-1], offers)

    speed: list[float] = []
    monkeypatch.setattr("benchmarks.keys.key_round", fake)
    monkeypatch.setattr("benchmarks.keys.in_turn", lambda *_, **__: turns)
    result = measure(rounds=3)
    assert result["steps_per_second"] == {"off": 100.0, "on": 50.0}
    assert result["ratio"] == 0.5
    assert result["coin"] == turns
    assert calls[:2] == [("fast", loop) for loop in ("off", "on")]
    assert calls[4:6] == [("fast", loop) for loop in ("on", "off")]  # they take turns
    assert result["offers_us"]["fast"]["on"] == {
        "offers": 9, "p50": 2.0, "p90": 3.0, "p99": 3.0, "longest": 3.0,
    }  # fmt: skip
    assert result["offers_us"]["x50"]["distilling"] == {"offers": 0}
    assert "keys, a block is distilled" in render(result)
    assert "by turns of 1 s: 0.800 of keys alone [0.750, 0.850]" in render(result)
    assert "x50: an offer while a block is distilled, later by: not seen" in render(result)


@pytest.mark.long
@pytest.mark.parametrize("added", [0.0, 30.0])
def test_a_delay_of_thirty_microseconds_is_seen_and_none_is_not(added: float) -> None:
    draw = random.Random(5)
    rounds = []
    for _ in range(4):
        base = draw.gauss(300, 40)  # rounds differ more than the two cases
        one, two = ([draw.gauss(base, 60) for _ in range(n)] for n in (1000, 150))
        rounds.append(KeyRound(1.0, {"off": [], "on": one, "distilling": [t + added for t in two]}))
    found = delay(rounds)
    assert found is not None
    assert found["low"] < found["mean"] < found["high"]
    assert abs(found["mean"] - added) < 15
    assert (found["low"] > 0) == (added > 0)
    few = KeyRound(1.0, {"off": [], "on": [1.0] * 100, "distilling": [1.0]})
    assert delay([few]) is None
