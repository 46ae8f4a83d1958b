"""Whether an end keeps up: judged from its counts, told once, read without an interpreter."""

import os
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from runtime.health import Liveness

ROOT = Path(__file__).resolve().parents[2]


def lines(beats: Sequence[tuple[float, int, int]]) -> list[tuple[str, str]]:
    judge = Liveness()
    return [judge.beat(*beat)[:2] for beat in beats]


def test_an_end_that_meets_no_partner_says_once_what_it_waits_for() -> None:
    judge = Liveness()
    told = [judge.beat(t, 0, 0, meeting=True) for t in range(30)]
    assert all(beat.line.startswith("bad: waiting for the other end") for beat in told)
    (t,) = (t for t, beat in enumerate(told) if beat.notice)
    assert t == 5
    assert "is it running, with the same --loop, and does one end connect" in told[5].notice
    assert judge.beat(30, 5, 0).notice == "keeps up again, 5 transitions"


def test_a_silent_partner_is_told_once_and_its_return_once() -> None:
    told = lines(
        [(t, 100, 0) for t in range(1, 33)] + [(33, 110, 30), (34, 120, 30), (60, 380, 30)]
    )
    assert [line.split(":")[0] for line, _ in told[:7]] == ["ok"] * 5 + ["bad"] * 2
    notices = [notice for _, notice in told if notice]
    assert notices[0].startswith("no transition for 5 s: the other end is frozen, gone or off")
    assert notices[-1].startswith("keeps up again, ")
    assert len(notices) == 2


def test_many_missed_steps_are_no_health() -> None:
    told = lines([(t, 12 * t, 88 * t) for t in range(1, 20)])
    assert told[-1][0].startswith("bad: 88 % of the last ")
    assert "too slow for the pace" in told[-1][0]
    few = lines([(t, 90 * t, 10 * t) for t in range(1, 20)])
    assert few[-1][0].endswith("10 % missed lately")


def healthy(folder: Path) -> tuple[int, str]:
    """What the check of the containers says of the plant whose folder this is."""
    command = [str(ROOT / "deploy" / "healthy"), "plant", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.strip()


def test_the_check_of_the_containers_reads_it_without_python(tmp_path: Path) -> None:
    def check() -> tuple[int, str]:
        return healthy(tmp_path)

    assert check() == (1, "plant has not reported yet")
    health = tmp_path / "status.json"
    health.write_text('{"health":"ok: 12 transitions","k":7}')
    assert check() == (0, "ok: 12 transitions")
    health.write_text('{"health":"bad: 88 % missed","k":7}')
    assert check() == (1, "bad: 88 % missed")
    health.write_text('{"health":"ok: 12 transitions","k":7}')
    os.utime(health, (time.time() - 60,) * 2)
    code, told = check()
    assert code == 1
    assert told.endswith("s ago: frozen or gone")


def test_a_host_is_healthy_where_all_its_loops_are(tmp_path: Path) -> None:
    lines = [tmp_path / f"loop-{n}" / "plant" / "status.json" for n in range(3)]
    for line in lines:
        line.parent.mkdir(parents=True)
        line.write_text('{"health":"ok: 12 transitions","k":7}')
    assert healthy(tmp_path / "plant") == (0, "ok: 3 loops")
    lines[1].write_text('{"health":"bad: no transition for 7 s","k":7}')
    assert healthy(tmp_path / "plant") == (1, "bad: 1 of 3 loops; the first: no transition for 7 s")
    os.utime(lines[2], (time.time() - 60,) * 2)
    code, told = healthy(tmp_path / "plant")
    assert code == 1
    assert told == "bad: 2 of 3 loops; the first: no transition for 7 s"
