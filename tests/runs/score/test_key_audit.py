"""What the audit of a run says of her: by direction, and of what she was there for alone."""

import random
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import pytest

from protocol.messages import Measurement, Offer
from runtime.chance import fresh_nonce
from runtime.logs import logger
from runtime.recording import Bounds
from runtime.run_folder import CAPTURE, CONTROLLER_TRACE, PLANT_TRACE
from tap_service.capture.recording import RotatingLog, mirror_line
from tap_service.inference.miss_rate import ALL
from tests.support.scenarios import changed
from tests.support.traced import met, session, transition, write_run
from wyner.runs.run import Run
from wyner.runs.score.keys import KeyAudit, audit_keys, key_lines

S = "1" * 16
STEPS = 600
HeardBy = Callable[[str, int], bool]
"""Whether she heard the copy 0 of that message of that step."""


def message(topic: str, k: int) -> Offer | Measurement:
    if topic == "offer":
        return Offer(session=S, k=k, candidates=((0.0,),) * 4, cipher=0, nonce=fresh_nonce())
    applied = {"applied_k": k - 1, "x_after": (0.0, 0.0)} if k else {"applied_k": -1, "x_after": ()}
    return Measurement.model_validate(
        {"session": S, "k": k, "x": (0.0, 0.0), "nonce": fresh_nonce(), **applied}
    )


def audited(
    run_dir: Path,
    heard: HeardBy,
    lives: tuple[range, ...] = (range(STEPS),),
    appearances: Mapping[int, int] = MappingProxyType({}),
    claimed: int = 1,
) -> KeyAudit:
    """An audit of STEPS transitions, of which she recorded ``lives``.

    ``appearances`` says from which steps on the plant's messages leave how often; the claim is of
    ``claimed`` at most.
    """
    plant = [session(S)]
    for k in range(STEPS):
        if k in appearances:
            plant.append({"event": "appearances", "session": S, "k": k, "times": appearances[k]})
        plant.append(transition(S, k, k, size=4, counts=3 * (k > 0)))
    write_run(run_dir, "keys", plant=plant, controller=[met(S)])
    for life in lives:
        tap = {"vantage": "tap", "appearances": 1}
        capture = RotatingLog(run_dir / CAPTURE, tap, Bounds(free_bytes=0), logger("tap"))
        for k in life:
            for topic in ("measurement", "offer"):
                if heard(topic, k):
                    capture.write(mirror_line(k, topic, message(topic, k).wire()))
        capture.close()
    return audit_of(run_dir, claimed)


def audit_of(run_dir: Path, claimed: int = 1) -> KeyAudit:
    audit = audit_keys(Run.load(run_dir), changed("keys", keys={"appearances": claimed}))
    assert audit is not None
    return audit


def losing(offers: float, measurements: float, seed: int = 1) -> HeardBy:
    draw = random.Random(seed)
    shares = {"offer": offers, "measurement": measurements}
    return lambda topic, _k: draw.random() >= shares[topic]


def test_a_tap_that_misses_offers_only_is_told_by_direction(tmp_path: Path) -> None:
    """Pooled she misses 35 %, above the 30 % of the claim."""
    audit = audited(tmp_path, losing(0.7, 0.0))
    assert audit.missed is not None
    assert audit.missed > 0.3
    (warning,) = (text for text in audit.warnings if "refuted" in text)
    assert " of the measurements at most, and eps_E = 0.3 was claimed" in warning
    assert not audit.rates["offers"].refuted


def test_a_tap_that_is_as_claimed_is_not_told_of(tmp_path: Path) -> None:
    audit = audited(tmp_path, losing(0.3, 0.3))
    assert audit.warnings == ()
    assert audit.rates[ALL].copies > 2 * STEPS - 20


def test_who_comes_late_and_hears_all_refutes_the_claim(tmp_path: Path) -> None:
    """Of all copies she missed 83 %."""
    audit = audited(tmp_path, losing(0.0, 0.0), lives=(range(500, STEPS),))
    assert audit.missed == 0
    assert sum("refuted" in text for text in audit.warnings) == 3  # both together, too
    assert audit.rates["offers"].absent == 501


def test_who_was_started_again_was_not_there_in_between(tmp_path: Path) -> None:
    audit = audited(tmp_path, losing(0.3, 0.3), lives=(range(200), range(400, 500)))
    assert audit.warnings == ()
    for name, rate in audit.rates.items():
        assert 280 < rate.copies / (2 if name == ALL else 1) < 300
        assert 0.2 < rate.missed / rate.copies < 0.4


def test_who_was_never_there_is_said_not_to_have_been(tmp_path: Path) -> None:
    audit = audited(tmp_path, losing(1.0, 1.0))
    assert audit.missed is None
    assert [text.partition(":")[0] for text in audit.warnings] == ["Eve was not there"] * 2


def test_what_left_too_often_is_no_copy_0_and_no_miss(tmp_path: Path) -> None:
    """The plant's messages left twice from step 100 to 399: all were copies 1."""

    def heard(topic: str, k: int) -> bool:
        return topic == "offer" or not 100 <= k < 400

    audit = audited(tmp_path, heard, appearances={0: 1, 100: 2, 400: 1})
    rate = audit.rates["measurements"]
    assert (rate.missed, rate.refuted) == (0, True)
    assert rate.copies < 310


def test_messages_that_left_twice_are_judged_by_themselves(tmp_path: Path) -> None:
    def heard(topic: str, k: int) -> bool:
        return k >= 300 or topic == "offer" or k % 3 > 0

    audit = audited(tmp_path, heard, appearances={0: 1, 300: 2}, claimed=2)
    twice = "measurements that left 2 times"
    assert set(audit.rates) == {"offers", "measurements", twice, ALL}
    assert not audit.rates["measurements"].refuted
    assert audit.rates[twice].refuted


def test_where_nobody_listened_nobody_holds_anything_and_it_is_said(tmp_path: Path) -> None:
    """Without a capture nothing was missed: all bits were held, and a red line said so."""
    audit = audited(tmp_path, losing(0.0, 0.0), lives=())
    assert audit.blocks
    assert all(block.missed is None and block.held_bits is None for block in audit.blocks)
    assert (audit.held_bits, audit.warnings) == (0, ())
    told = audit.as_json()
    assert told["held_by_tap_bits"] is None
    assert "Nobody listened: what Eve would hold is not known." in key_lines(told)[0]
    heard = audited(tmp_path / "heard", losing(0.0, 0.0))
    assert "Eve holds 0 bits of their blocks." in key_lines(heard.as_json())[0]
    assert "Nobody" not in key_lines(heard.as_json())[0]


@pytest.mark.parametrize("path", [PLANT_TRACE, CONTROLLER_TRACE])
def test_a_damaged_trace_does_not_read_as_fewer_keys(tmp_path: Path, path: Path) -> None:
    whole = audited(tmp_path, losing(0.0, 0.0))
    assert not whole.unread
    lines = (tmp_path / path).read_bytes().splitlines(keepends=True)
    lines[2 if path == CONTROLLER_TRACE else 300 : 301] = [b'{"event":"session"}\n']
    (tmp_path / path).write_bytes(b"".join(lines))
    damaged = audit_of(tmp_path)
    (why,) = damaged.unread
    assert str(path) in why
    assert f"counted up to there: {why}" in damaged.warnings
