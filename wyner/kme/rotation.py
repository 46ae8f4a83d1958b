"""A fresh key at both ends again and again: fetched under one id, compared, handed to a program.

The master connects to the slave, fetches a key and tells its id with a proof that it has it; the
slave fetches the same key by its id, checks the proof, takes the key into use and answers with a
proof of its own. A proof is an HMAC under the key, so whoever listens here may test guesses of the
key: against her it is as good as 256 bits are, no longer beyond all computing. TLS and WireGuard,
for which it is meant, are no better.
"""

import base64
import hmac
import json
import os
import queue
import shlex
import socket
import ssl
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Literal

from protocol.secret.records import Key
from wyner.kme.client import TIMEOUT_S, KeyClient, NoKey
from wyner.kme.identity import common_name

MOST_BYTES: Final = 4096
"""Of a line between the two ends."""

HAND_OVER_S: Final = 20.0
"""A program that takes a key has so long; the partner waits a little longer for the answer."""

MOST_AT_ONCE: Final = 64
"""Connections that shake hands."""

LOOK_S: Final = 0.2

Role = Literal["master", "slave"]
Use = Callable[[Key], None]


class NotRotated(Exception):
    """No new key came into use at both ends; the text is one line and says why."""


def proof(key: Key, role: Role) -> str:
    """What shows that ``role`` has the key of that id."""
    return hmac.digest(key.key, f"wyner rotate/{role}/{key.key_id}".encode(), "sha256").hex()


def _check(key: Key, role: Role, told: object) -> None:
    if not isinstance(told, str) or not hmac.compare_digest(
        told.encode(), proof(key, role).encode()
    ):
        raise NotRotated(f"{key.key_id}: the {role} has another key under this id")


def hand_to(command: str) -> Use:
    """Use of a key: run a command with the key, in base64, on its standard input.

    Its environment names the id: ``WYNER_KEY_ID``.
    """
    words = shlex.split(command)

    def use(key: Key) -> None:
        try:
            done = subprocess.run(
                words,
                input=base64.b64encode(key.key) + b"\n",
                env=os.environ | {"WYNER_KEY_ID": key.key_id},
                capture_output=True,
                timeout=HAND_OVER_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise NotRotated(f"{words[0]}: {error}") from None
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise NotRotated(f"{words[0]}: exit code {done.returncode}: {' '.join(said)}")

    return use


def lead(line: ssl.SSLSocket, client: KeyClient, slave: str, use: Use) -> str:
    """Make one new key the one in use, as master; its id.

    Raises
    ------
    NotRotated
        A key that was fetched is lost then, and a fresh one comes with the next attempt.
    """
    try:
        (key,) = client.enc_keys(slave)
    except NoKey as error:
        raise NotRotated(str(error)) from None
    _tell(line, {"key_ID": key.key_id, "proof": proof(key, "master")})
    answer = _told(line, HAND_OVER_S + 3 * TIMEOUT_S)
    if "error" in answer:
        raise NotRotated(f"{slave}: {answer['error']}")
    _check(key, "slave", answer.get("proof"))
    use(key)
    return key.key_id


def follow(line: ssl.SSLSocket, client: KeyClient, master: str, use: Use) -> str:
    """Take the master's key into use, as slave, and say so; its id.

    Raises
    ------
    NotRotated
        The master has been told why.
    """
    asked = _told(line, 2 * TIMEOUT_S)
    try:
        try:
            (key,) = client.dec_keys(master, [str(asked.get("key_ID"))])
        except NoKey as error:
            raise NotRotated(str(error)) from None
        _check(key, "master", asked.get("proof"))
        use(key)
    except NotRotated as error:
        _tell(line, {"error": str(error)})
        raise
    _tell(line, {"key_ID": key.key_id, "proof": proof(key, "slave")})
    return key.key_id


def check_partner(line: ssl.SSLSocket, name: str) -> None:
    """Raise `NotRotated` unless the certificate over there is that of ``name``."""
    found = common_name(line.getpeercert())
    if found != name:
        raise NotRotated(f"certificate: got {found!r}, expected {name!r}")


def _tell(line: ssl.SSLSocket, message: dict[str, str]) -> None:
    try:
        line.sendall(json.dumps(message).encode() + b"\n")
    except OSError as error:
        raise NotRotated(f"the other end: {error}") from None


def _told(line: ssl.SSLSocket, within_s: float) -> dict[str, Any]:
    line.settimeout(within_s)
    try:
        with line.makefile("rb") as lines:
            sent = lines.readline(MOST_BYTES)
        if not sent:
            raise NotRotated("the other end: hung up without a word")
        said = json.loads(sent)
    except TimeoutError:
        raise NotRotated(f"the other end: no word within {within_s:g} s") from None
    except OSError as error:
        raise NotRotated(f"the other end: {error}") from None
    except ValueError:
        raise NotRotated("the other end: expected an object") from None
    if not isinstance(said, dict):
        raise NotRotated("the other end: expected an object")
    return said


def connected(address: tuple[str, int], tls: ssl.SSLContext) -> ssl.SSLSocket:
    """A line to the slave.

    Raises
    ------
    NotRotated
    """
    try:
        plain = socket.create_connection(address, TIMEOUT_S)
        try:
            return tls.wrap_socket(plain, server_hostname=address[0])
        except OSError:
            plain.close()
            raise
    except OSError as error:
        raise NotRotated(f"{address[0]}:{address[1]}: {error}") from None


class Reception:
    """Lines of masters; whoever shows no certificate holds nobody up.

    Each that comes shakes hands on a thread of its own, and the oldest that has not is sent away
    where they are too many.

    Parameters
    ----------
    listening : socket
        Closed by its owner, which ends the reception.
    tls : SSLContext
    """

    def __init__(self, listening: socket.socket, tls: ssl.SSLContext) -> None:
        self._listening, self._tls = listening, tls
        self._shaking: deque[ssl.SSLSocket] = deque()
        self._came: queue.Queue[ssl.SSLSocket | NotRotated] = queue.Queue(MOST_AT_ONCE)
        threading.Thread(target=self._receive, name="reception", daemon=True).start()

    def next(self, wait_s: float) -> ssl.SSLSocket:
        """The next line from a master.

        Raises
        ------
        TimeoutError
            When nobody came.
        NotRotated
            When whoever came has no certificate of the authority, or is too slow.
        """
        try:
            came = self._came.get(timeout=wait_s)
        except queue.Empty:
            raise TimeoutError from None
        if isinstance(came, NotRotated):
            raise came
        return came

    def _receive(self) -> None:
        while True:
            try:
                plain, _ = self._listening.accept()
            except TimeoutError:
                continue
            except OSError:
                if self._listening.fileno() < 0:
                    return
                time.sleep(LOOK_S)  # no descriptor is left, as a rule
                continue
            plain.settimeout(TIMEOUT_S)
            try:
                line = self._tls.wrap_socket(plain, server_side=True, do_handshake_on_connect=False)
            except OSError:
                plain.close()
                continue
            self._shaking.append(line)
            if len(self._shaking) > MOST_AT_ONCE:
                with suppress(OSError, IndexError):
                    socket.socket.shutdown(self._shaking.popleft(), socket.SHUT_RDWR)
            threading.Thread(target=self._shake, args=(line,), daemon=True).start()

    def _shake(self, line: ssl.SSLSocket) -> None:
        came: ssl.SSLSocket | NotRotated = line
        try:
            line.do_handshake()
        except OSError as error:
            line.close()
            came = NotRotated(f"a connection: {error}")
        with suppress(ValueError):
            self._shaking.remove(line)
        if isinstance(came, NotRotated) and not self._came.empty():
            return  # one is enough, and masters need the room
        try:
            self._came.put_nowait(came)
        except queue.Full:  # its master tries again
            line.close()
