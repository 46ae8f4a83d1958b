"""A medium of the air's kind, in user space: what one station sends, each other one may miss.

Each station is a network namespace with one interface, whose other end this process holds. It hands
every frame to every other station, and to radios that listen and are no station. Each of these
misses a frame with its own probability, drawn frame by frame from a seed.
"""

import itertools
import json
import os
import random
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from select import select
from typing import Any, Final

from tests.support.patience import PATIENCE_S

LARGEST_FRAME: Final = 1 << 17
SOL_PACKET: Final = 263
PACKET_VNET_HDR: Final = 15
ALL_FRAMES: Final = 0x0003
OUTGOING: Final = 4  # a packet's type, of what this process itself has sent
GREETING_BYTES: Final = 260
"""Shorter frames are never missed: a lost greeting of the transport's would only cost seconds."""

NUMBERS: Final = itertools.count(1)
DECODER: Final = json.JSONDecoder()


class NoNamespaces(Exception):
    """Network namespaces cannot be used here; the text says why."""


def sh(*command: str) -> None:
    """Run a command that must work."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoNamespaces(f"{' '.join(command)}: {done.stderr.strip()}")


class Radio:
    """Hears every frame, whomever it is for, but for a share that it misses; sends nothing."""

    def __init__(self, loss: float, seed: str) -> None:
        self.loss = loss
        self._draw = random.Random(seed)
        self.frames = self.missed = 0
        self.heard: list[tuple[int, str, dict[str, Any]]] = []
        """Time, topic and fields of each field message in what it heard."""

    def hear(self, frame: bytes) -> None:
        """Take a frame, or miss it."""
        at = frame.find(b'{"v":')
        if at < 0:
            return
        self.frames += 1
        if self._draw.random() < self.loss:
            self.missed += 1
            return
        while at >= 0:
            with suppress(ValueError):
                fields, _ = DECODER.raw_decode(frame[at:].decode("latin-1"))
                topic = "offer" if "candidates" in fields else "measurement"
                if "copy_number" in fields:
                    self.heard.append((time.time_ns(), topic, fields))
            at = frame.find(b'{"v":', at + 1)


class Station:
    """A machine on the medium."""

    def __init__(self, name: str, number: int, loss: float, seed: str) -> None:
        self.name = name
        self.address = f"10.231.9.{number}"
        self.prefix = ["ip", "netns", "exec", name]
        self.link = f"{name}x"
        self.loss = loss
        self.draw = random.Random(seed)
        self.sent = 0
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_FRAMES))

    def open(self) -> None:
        """Put it on the medium."""
        name = self.name
        sh("ip", "netns", "add", name)
        inside = ("ip", "-n", name)
        sh("ip", "link", "add", self.link, "type", "veth", "peer", "name", "air", "netns", name)
        sh(*inside, "link", "set", "lo", "up")
        sh(*inside, "addr", "add", f"{self.address}/24", "dev", "air")
        sh(*inside, "link", "set", "air", "up")
        sh(*inside, "route", "add", "224.0.0.0/4", "dev", "air")
        sh("ip", "link", "set", self.link, "up")
        # A frame goes on with what its sender left for a network card to do, such as checksums.
        self.socket.setsockopt(SOL_PACKET, PACKET_VNET_HDR, 1)
        self.socket.bind((self.link, 0))
        self.socket.setblocking(False)

    def close(self) -> None:
        """Take it off the medium."""
        self.socket.close()
        with suppress(NoNamespaces):
            sh("ip", "netns", "del", self.name)  # the link goes with it


class Medium:
    """Stations and radios on one channel; made by :func:`medium`."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self.stations: list[Station] = []
        self.radios: list[Radio] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)

    def station(self, loss: float = 0.0) -> Station:
        """A new machine, which misses a share ``loss`` of the frames."""
        number = len(self.stations) + 1
        # a namespace goes some time after it was removed, so no name serves twice in a process
        name = f"wy{os.getpid() % 10**6}n{next(NUMBERS)}"
        made = Station(name, number, loss, f"station {number} {self._seed}")
        self.stations.append(made)
        made.open()
        return made

    def radio(self, loss: float) -> Radio:
        """A new one that only listens."""
        made = Radio(loss, f"radio {len(self.radios)} {self._seed}")
        self.radios.append(made)
        return made

    def start(self) -> None:
        """Carry frames from here on; no more stations may come."""
        self._thread.start()

    def _carry(self) -> None:
        by_socket = {one.socket: one for one in self.stations}
        while not self._over.is_set():
            for ready in select(list(by_socket), [], [], 0.1)[0]:
                sender = by_socket[ready]
                for _ in range(64):
                    try:
                        frame, where = ready.recvfrom(LARGEST_FRAME)
                    except BlockingIOError:
                        break
                    if where[2] != OUTGOING:
                        self._send(sender, frame)

    def _send(self, sender: Station, frame: bytes) -> None:
        sender.sent += 1
        for station in self.stations:
            if station is sender:
                continue
            lost = len(frame) > GREETING_BYTES and station.draw.random() < station.loss
            if not lost:
                with suppress(OSError):
                    station.socket.send(frame)
        for radio in self.radios:
            radio.hear(frame)

    def close(self) -> None:
        """End it, and remove all namespaces."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(PATIENCE_S)
        for station in self.stations:
            station.close()


@contextmanager
def medium(seed: int, losses: Sequence[float]) -> Iterator[Medium]:
    """A medium with a station for each loss.

    Raises
    ------
    NoNamespaces
        Where they cannot be made.
    """
    if os.geteuid() != 0 or shutil.which("ip") is None:
        raise NoNamespaces("network namespaces need root and the program ip")
    made = Medium(seed)
    try:
        for loss in losses:
            made.station(loss)
        yield made
    finally:
        made.close()
