"""The live service on buses in memory, and as a process over real Zenoh."""

import base64
import gc
import json
import logging
import os
import random
import signal
from pathlib import Path

import pytest

from protocol.messages import (
    FIELD,
    FieldMessage,
    Offer,
    TapStatus,
)
from protocol.topics import key_of
from runtime.recording import Bounds
from runtime.run_folder import BELIEFS, CAPTURE, GUESSES, TAP_STATUS
from studies.secrecy.runs import Run, simulate
from tap_service import beside
from tap_service import service as tap
from tap_service.capture.channel import View
from tap_service.capture.reading import CaptureReader
from tap_service.capture.transcript import Transition
from tap_service.config import TapConfig
from tap_service.eavesdroppers import Guess, KnowledgeError
from tap_service.service import TapService
from tests.support.memory_bus import MemoryBus, MemoryHub
from tests.support.patience import PATIENCE_S, wait_for
from tests.support.told import log_of, told
from wyner.runs.score.replay import hear_again

LIGHT = ("set-membership", "nearest-centre")


def config(run: Run, run_dir: Path, **more: object) -> TapConfig:
    settings: dict[str, object] = {
        "names": LIGHT,
        "limits": Bounds(free_bytes=0),
        "finish_s": PATIENCE_S,
    } | more
    return TapConfig(
        run_dir,
        run.scenario.knowledge(),
        run.scenario.oracle_knowledge(),
        **settings,  # type: ignore[arg-type]
    )


class Wire:
    """The tap service on two hubs, with someone who sends and someone who watches."""

    def __init__(self, settings: TapConfig) -> None:
        field, adversary = MemoryHub(), MemoryHub()
        self.statuses: list[TapStatus] = []
        self.service = TapService(settings)
        self.service.attach(MemoryBus(field), MemoryBus(adversary))
        self._sender = MemoryBus(field)
        MemoryBus(adversary).subscribe(
            key_of(TapStatus, "loop"),
            lambda _k, p, _t: self.statuses.append(TapStatus.model_validate_json(p)),
        )
        self._put = {k: self._sender.publisher(key_of(k, "loop")).put for k in FIELD}

    def send(self, message: FieldMessage) -> None:
        self._put[type(message)](message.wire())

    def send_bytes(self, payload: bytes) -> None:
        self._put[Offer](payload)

    def finish(self) -> None:
        self.service.finish()
        self.service.close()


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def health_in(run_dir: Path) -> str:
    told: str = json.loads((run_dir / TAP_STATUS).read_bytes())["health"]
    return told


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(300, 11)


def test_guesses_are_logged_step_by_step_with_a_probability(run: Run, tmp_path: Path) -> None:
    wire = Wire(config(run, tmp_path))
    for message in run.messages:
        wire.send(message)
    wire.finish()
    guesses = [e for e in lines(tmp_path / GUESSES) if e["event"] == "guess"]
    for name in LIGHT:
        mine = [g for g in guesses if g["name"] == name]
        assert [g["k"] for g in mine] == list(range(300))
        assert all(0.5 <= float(str(g["p"])) <= 1 for g in mine)
    session = run.messages[0].session
    nearest = {(session, g["k"]): g["symbol"] for g in guesses if g["name"] == "nearest-centre"}
    assert all(nearest[at] == key for at, key in run.truth.keys.items())
    assert {s.name for s in wire.statuses} == set(LIGHT)
    assert all(len(s.tail) <= 32 for s in wire.statuses)


def test_a_malformed_message_is_kept_counted_and_harms_nothing(run: Run, tmp_path: Path) -> None:
    rng = random.Random(2)
    wire = Wire(config(run, tmp_path))
    junk = [rng.randbytes(rng.randrange(60)) for _ in range(40)]
    junk += [b"{}", b"null", b'{"v":3}', run.messages[0].wire()]
    for i, message in enumerate(run.messages):
        wire.send(message)
        if i < len(junk):
            wire.send_bytes(junk[i])
    with log_of("tap") as said:
        wire.finish()
    reader = CaptureReader(tmp_path)
    assert [m for _, m in reader.records()] == list(run.messages)
    kept = [e for e in lines(tmp_path / CAPTURE) if e["event"] == "malformed"]
    assert [base64.b64decode(str(e["base64"])) for e in kept] == junk
    assert {e["key"] for e in kept} == {key_of(Offer, "loop")}
    assert reader.malformed == wire.statuses[-1].unused.malformed == len(junk)
    assert told(said, "undecodable") == len(junk)


def test_the_view_acts_before_the_capture_so_a_replay_hears_the_same(
    run: Run, tmp_path: Path
) -> None:
    view = View(loss=0.2, noise=0.01, delay=5, seed=3)
    wire = Wire(config(run, tmp_path, view=view))
    for message in run.messages:
        wire.send(message)
    wire.finish()
    live = [e for e in lines(tmp_path / GUESSES) if e["event"] == "guess"]
    replay = hear_again(tmp_path, LIGHT)
    assert replay.reader.header["view"] == view.model_dump()
    for said in replay.taps:
        mine = {(e["session"], e["k"]): e["symbol"] for e in live if e["name"] == said.name}
        assert mine == said.live
    assert 0.7 < sum(1 for _ in CaptureReader(tmp_path).records()) / len(run.messages) < 0.9


def test_an_overflowing_queue_drops_counts_and_does_not_grow(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tap, "QUEUE_BYTES", 40_000)
    wire = Wire(config(run, tmp_path))
    for message in run.messages:
        wire.send(message)
    waiting = len(wire.service.queue)
    assert 50 < waiting < 150
    wire.finish()
    assert wire.statuses[-1].mirrored == waiting
    assert wire.statuses[-1].unused.dropped == len(run.messages) - waiting


def test_a_busy_tap_goes_on_mirroring_and_leaves_out_the_guessing(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """At its end it says of how many."""
    monkeypatch.setattr(tap, "BUSY_LENGTH", 200)
    wire = Wire(config(run, tmp_path))
    wire.service.log = logging.getLogger("busy tap")
    for message in run.messages:
        wire.send(message)
    wire.finish()
    status = wire.statuses[-1]
    assert status.mirrored == len(run.messages)
    assert status.unused.dropped == len(run.messages) - 201
    assert 0 < status.steps < 300
    left_out = f"{status.unused.dropped} messages were mirrored and not guessed at"
    assert any(line.startswith(left_out) for line in caplog.messages)
    assert json.loads((tmp_path / TAP_STATUS).read_bytes())["unguessed"] == status.unused.dropped


@pytest.mark.long
def test_what_the_tap_could_not_use_is_in_its_status_its_beliefs_and_its_health(
    run: Run, tmp_path: Path
) -> None:
    """A tap that no longer followed the true session looked like a secret that was kept."""
    wire = Wire(config(run, tmp_path, names=("nearest-centre", "list-decoder")))
    late, *others = run.messages[101], *run.messages[:101], *run.messages[102:]
    for i, message in enumerate(others):
        wire.send(message)
        if i % 20 == 0:
            wire.send(message.model_copy(update={"session": f"{i % 3:016x}"}))
    wire.send(late)
    wire.finish()
    for name in ("nearest-centre", "list-decoder"):
        (status,) = [s for s in wire.statuses if s.name == name][-1:]
        assert (status.unused.foreign, status.unused.late, status.unused.jumped) == (30, 1, 0)
        assert (status.steps, status.lost) == (300, 1)
        record = json.loads((tmp_path / BELIEFS).read_bytes())[name]
        assert record["unused"]["foreign"] == 30
        assert record["unused"]["late"] == 1
    health = health_in(tmp_path)
    assert health.startswith("bad: ")
    assert "not used: 30 messages of other sessions, 1 late, 0 dropped" in health
    holes = [e["k"] for e in lines(tmp_path / GUESSES) if e.get("hole")]
    assert holes == [50]


def test_a_tap_that_is_started_again_says_so(run: Run, tmp_path: Path) -> None:
    for times in range(3):
        wire = Wire(config(run, tmp_path))
        for message in run.messages:
            wire.send(message)
        wire.finish()
        assert wire.statuses[-1].unused.restarts == times
        beliefs = json.loads((tmp_path / BELIEFS).read_bytes())
        assert beliefs["nearest-centre"]["unused"]["restarts"] == times


@pytest.mark.parametrize("names", [("list-decoder", "oracle"), ("nobody",)])
def test_a_wrong_choice_is_told_before_anything_starts(
    run: Run, tmp_path: Path, names: tuple[str, ...]
) -> None:
    settings = TapConfig(tmp_path, run.scenario.knowledge(), None, names=names)
    with pytest.raises(KnowledgeError):
        TapService(settings)
    assert not (tmp_path / "tap").exists()


@pytest.mark.long
def test_memory_stays_flat_over_many_steps(tmp_path: Path) -> None:
    import tracemalloc

    run = simulate(600, 4)
    limits = Bounds(part_bytes=25_000, total_bytes=100_000, free_bytes=0)
    wire = Wire(config(run, tmp_path, limits=limits))
    sizes = []
    logging.disable()  # pytest keeps every record, and a part that is dropped is told of
    tracemalloc.start()
    try:
        for turn in range(4):
            for message in run.messages:
                # the same loop again, as another session
                wire.send(message.model_copy(update={"session": f"{turn:016x}"}))
                wire.service.work(0)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
        logging.disable(logging.NOTSET)
    wire.finish()
    # message symbols are kept up to a bound that is not reached here: 5 kB a turn
    assert sizes[3] - sizes[2] < 10_000
    assert sum(p.stat().st_size for p in (tmp_path / "tap").glob("capture*")) <= 100_000


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_is_not_for_the_heavy_eavesdroppers_process(
    run: Run, tmp_path: Path
) -> None:
    wire = Wire(config(run, tmp_path, names=("list-decoder",)))
    child = wire.service.beside[0].process
    assert os.getpgid(child.pid) == child.pid != os.getpgid(0)  # from its start on
    wire.finish()
    assert child.end(PATIENCE_S) == 0


@pytest.mark.slow
def test_a_heavy_eavesdropper_whose_process_dies_is_said_to_and_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dead one has nothing new to say; what she said last must not look like what Eve says."""
    monkeypatch.setattr(beside, "REST_S", 0.3)
    run = simulate(100, 11)
    half = len(run.messages) // 2
    wire = Wire(config(run, tmp_path, names=("list-decoder",)))

    def newest() -> TapStatus | None:
        wire.service.work(0)
        wire.service.publish()
        return wire.statuses[-1] if wire.statuses else None

    for message in run.messages[:half]:
        wire.send(message)
    wait_for(lambda: (its := newest()) is not None and its.steps > 0, "a first look")
    said = wire.statuses[-1]
    process = wire.service.beside[0].process
    with log_of("tap") as knowledge_of:
        os.kill(process.pid, signal.SIGKILL)
        for message in run.messages[half:]:
            wire.send(message)
        wait_for(lambda: (its := newest()) is not None and its.failed != "", "a word of her death")
        dead = wire.statuses[-1]
        assert dead.failed == "its process died (signal 9)"
        assert dead.steps == said.steps
        assert dead.behind >= 45  # what was captured since: nobody has looked at it
        wire.service.write_beliefs()
        record = json.loads((tmp_path / BELIEFS).read_bytes())["list-decoder"]
        assert record["failed"] == dead.failed
        assert "its process died" in health_in(tmp_path)
        wait_for(lambda: (its := newest()) is not None and not its.failed, "another process")
    assert any("started again" in line for line in knowledge_of)
    assert wire.service.beside[0].process is not process
    wire.finish()
    record = json.loads((tmp_path / BELIEFS).read_bytes())["list-decoder"]
    assert (record["failed"], record["behind"]) == ("", 0)
    assert wire.statuses[-1].steps == 100
    assert wire.statuses[-1].unused.restarts == record["unused"]["restarts"] == 1


@pytest.mark.slow
def test_a_heavy_eavesdropper_who_dies_too_often_has_failed(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beside, "RESTARTS", 0)
    wire = Wire(config(run, tmp_path, names=("nearest-centre", "list-decoder")))
    process = wire.service.beside[0].process
    os.kill(process.pid, signal.SIGKILL)  # before it has said a word
    for message in run.messages:
        wire.send(message)
    with log_of("tap") as knowledge_of:
        wire.finish()
    assert any("it died 1 times, and is not started again" in line for line in knowledge_of)
    records = json.loads((tmp_path / BELIEFS).read_bytes())
    assert records["nearest-centre"]["failed"] == ""
    assert records["list-decoder"]["failed"] == "its process died (signal 9)"
    assert records["list-decoder"]["behind"] == 300
    assert {s.name: s.failed for s in wire.statuses}["list-decoder"] != ""


def test_an_eavesdropper_who_raises_is_told_of_in_the_status_the_log_and_the_records(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = Wire(config(run, tmp_path))
    nearest = wire.service.listeners.listeners[1].tap
    observe = nearest.observe

    def breaks(transition: Transition) -> Guess:
        if transition.k == 21:
            raise ValueError("no\nidea")
        return observe(transition)

    monkeypatch.setattr(nearest, "observe", breaks)
    with log_of("tap") as knowledge_of:
        for message in run.messages:
            wire.send(message)
        wire.finish()
    why = "step 21: ValueError: no idea"
    assert f"eavesdropper nearest-centre failed at {why}" in knowledge_of
    last = {s.name: s for s in wire.statuses}
    assert last["nearest-centre"].failed == why
    assert why not in last["nearest-centre"].belief.message
    assert last["nearest-centre"].steps == 21
    assert last["set-membership"].failed == ""
    assert last["set-membership"].steps == 300
    record = json.loads((tmp_path / BELIEFS).read_bytes())["nearest-centre"]
    assert (record["failed"], record["symbols"]) == (why, None)
    assert "nearest-centre failed" in health_in(tmp_path)
