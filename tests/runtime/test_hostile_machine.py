"""A disk fills or turns read-only, a wall clock jumps: nothing is lost, and it goes on."""

import errno
import os
import random
import time
from pathlib import Path
from typing import Any

import pytest

from protocol.link.records import Side
from runtime.errors import Failure
from tests.support.pair import SIDES
from tests.support.recorded_pair import RecordedPair

MESSAGE = b"a"


@pytest.mark.parametrize("fault", ["full", "short", "read-only"])
@pytest.mark.parametrize("side", SIDES)
def test_a_disk_that_fails_stops_an_end_and_it_goes_on_exactly_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: Side, fault: str
) -> None:
    """The second write to its folder from the third transition on fails, and all later ones.

    A ``short`` one writes half, as on a disk that has become full. One that is ``read-only`` is so
    under the files that are open.
    """
    loop = RecordedPair(tmp_path, MESSAGE, name="keys")
    loop.run(lambda: loop.transitions >= 3)
    place = str(tmp_path / side)
    writes = 0
    code = errno.EROFS if fault == "read-only" else errno.ENOSPC

    def failing(name: str) -> Any:
        real = getattr(os, name)

        def write(file: int, data: bytes, *more: int) -> int:
            nonlocal writes
            if str(Path(f"/proc/self/fd/{file}").readlink()).startswith(place):
                writes += 1
                if writes > 1:
                    if fault == "short" and writes == 2:
                        return int(real(file, data[: len(data) // 2], *more))
                    raise OSError(code, os.strerror(code))
            return int(real(file, data, *more))

        return write

    with monkeypatch.context() as patched:
        for name in ("write", "pwrite"):
            patched.setattr(os, name, failing(name))
        with pytest.raises((Failure, OSError)) as error:
            loop.run(lambda: loop.delivered >= 1)
        named = error.value.filename if isinstance(error.value, OSError) else str(error.value)
        assert place in str(named)
        assert "\n" not in str(error.value)
        loop.kill(side)
    loop.start(side)
    loop.run(lambda: loop.delivered >= 1)
    assert loop.received == [MESSAGE]
    loop.stop()
    assert loop.wrong() == []


def test_a_wall_clock_that_jumps_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = random.Random(0)
    monkeypatch.setattr(time, "time", lambda: draw.uniform(0, 2e9))
    monkeypatch.setattr(time, "time_ns", lambda: draw.randrange(2 * 10**18))
    loop = RecordedPair(tmp_path, MESSAGE, name="keys")
    loop.run(lambda: loop.delivered >= 1)
    assert loop.received == [MESSAGE]
    loop.stop()
    assert loop.wrong() == []
