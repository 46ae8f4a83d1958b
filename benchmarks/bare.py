"""Bare Zenoh round trips: what the transport alone takes for a step's two messages."""

import multiprocessing
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Final

from protocol.messages import Measurement, Offer
from protocol.topics import DEFAULT_LOOP, key_of
from runtime.addresses import free_endpoints
from runtime.bus import ChannelClosed
from runtime.collection import freeze_startup
from runtime.errors import Failure
from runtime.zenoh_bus import ZenohBus

WARM_UP: Final = 0.1
"""Round trips that are made before the others are counted, as a part of them."""

REPEAT_S: Final = 0.05
"""Seconds after which a message is sent again where nothing came back."""

ANSWER_S: Final = 30.0
"""Seconds that a process has to start, to answer and to end."""

TRIP_LIMIT_S: Final = 0.02
"""A round trip may take so long before the round is given up."""


def _drive(pipe: Connection, listen: str, payload: bytes, trips: int, way: str) -> None:
    """Send, wait for the answer, ``trips`` times; report the trips a second."""
    with ZenohBus(listen=[listen]) as bus:
        answers = _answers(bus, key_of(Offer, DEFAULT_LOOP), way)
        publisher = bus.publisher(key_of(Measurement, DEFAULT_LOOP))
        freeze_startup()  # as the services do
        pipe.send("up")
        pipe.recv()
        made = [0]

        def repeat() -> None:
            """Send again where nothing came back, for the wait on a channel has no end."""
            seen = -1
            while made[0] >= 0:
                if made[0] == seen:
                    publisher.put(payload)
                seen = made[0]
                time.sleep(REPEAT_S)

        def trip() -> None:
            publisher.put(payload)
            answers()
            made[0] += 1

        threading.Thread(target=repeat, daemon=True).start()
        for _ in range(int(WARM_UP * trips) + 1):
            trip()
        began = time.perf_counter()
        for _ in range(trips):
            trip()
        pipe.send(trips / (time.perf_counter() - began))
        made[0] = -1
        pipe.recv()


def _answers(bus: ZenohBus, key: str, way: str) -> Callable[[], object]:
    """Waits for the next message: on a queue that a callback fills, or on a channel."""
    if way == "channel":
        channel = bus.channel(key, 64)
        return lambda: channel.receive(wait=True)
    inbox: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    bus.subscribe(key, lambda _k, body, _t: inbox.put(body))
    return lambda: inbox.get(timeout=ANSWER_S)


def _echo(pipe: Connection, listen: str, connect: str, payload: bytes, way: str) -> None:
    """Answer whatever comes."""
    with ZenohBus(listen=[listen], connect=[connect]) as bus:
        questions = _answers(bus, key_of(Measurement, DEFAULT_LOOP), way)
        publisher = bus.publisher(key_of(Offer, DEFAULT_LOOP))
        freeze_startup()  # as the services do
        pipe.send("up")

        def answer() -> None:
            with suppress(ChannelClosed):
                while True:
                    questions()
                    publisher.put(payload)

        threading.Thread(target=answer, daemon=True).start()
        pipe.recv()


def _listen(pipe: Connection, connect: Sequence[str]) -> None:
    """Hear both, as the tap does."""
    heard = [0]

    def count(*_: object) -> None:
        heard[0] += 1

    with ZenohBus(connect=connect) as bus:
        for message in (Measurement, Offer):
            bus.subscribe(key_of(message, DEFAULT_LOOP), count, patient=True)
        freeze_startup()  # as the services do
        pipe.send("up")
        pipe.recv()
        time.sleep(0.2)
        pipe.send(heard[0])


def bare_round(measurement: bytes, offer: bytes, trips: int, way: str) -> float:
    """Round trips a second between two bare processes, a third one listening.

    ``way`` is ``channel`` (a thread blocks on it, as in the services) or ``queue``.

    Raises
    ------
    runtime.errors.Failure
        When a process fails, or the listener does not hear what passes.
    """
    context = multiprocessing.get_context("spawn")
    driving, echoing = free_endpoints(2)
    targets: list[tuple[Callable[..., None], tuple[Any, ...]]] = [
        (_drive, (driving, measurement, trips, way)),
        (_echo, (echoing, driving, offer, way)),
        (_listen, ([driving, echoing],)),
    ]
    pipes: list[Connection] = []
    processes = []
    try:
        for target, arguments in targets:
            ours, theirs = context.Pipe()
            process = context.Process(target=target, args=(theirs, *arguments), daemon=True)
            process.start()
            theirs.close()
            pipes.append(ours)
            processes.append(process)
        for pipe in pipes:
            _receive(pipe, ANSWER_S)
        time.sleep(0.5)  # the listener's two connections
        pipes[0].send("go")
        trips_per_second = _receive(pipes[0], ANSWER_S + TRIP_LIMIT_S * trips)
        for pipe in reversed(pipes):
            pipe.send("end")
        heard = _receive(pipes[2], ANSWER_S)
        if heard < trips:
            raise Failure(f"the bare listener heard {heard} messages of {2 * trips}")
        for process in processes:
            process.join(10.0)
    finally:
        for process in processes:
            if process.is_alive():
                process.kill()
                process.join()
        for pipe in pipes:
            pipe.close()
    return float(trips_per_second)


def _receive(pipe: Connection, limit_s: float) -> Any:
    try:
        if pipe.poll(limit_s):
            return pipe.recv()
    except EOFError:
        raise Failure("a bare process ended before its time") from None
    raise Failure(f"a bare process did not answer within {limit_s:.0f} s")
