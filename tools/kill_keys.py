"""Kill -9 of controller, plant and both key servers, again and again, while keys are fetched.

At the end both stores must hold the same keys under the same ids in the same order, no key may have
been delivered twice at a side, each key must be the same at both ends, and every sealed message
must have been opened once and in order. Run it with ``python -m tools.kill_keys --kills 200``; with
``--loss``, ``--repeat`` and ``--delay`` the field bus goes through a relay that loses, repeats and
delays messages, and with ``--secret`` blocks are signed.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

from protocol.messages import Measurement, Offer, Sealed
from protocol.runtime.bus import TransportError
from protocol.runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from protocol.runtime.zenoh_bus import ZenohBus, free_endpoints
from protocol.secret.authentication import make_secret
from protocol.secret.ledger import pad_counts
from protocol.secret.records import Key
from protocol.secret.sealed_book import SealedBook
from protocol.secret.store import KeyStore
from protocol.shipped import SCENARIOS
from protocol.topics import DEFAULT_LOOP, key_of
from wyner.deployment.certificates import ensure_certificates
from wyner.kme.client import KeyClient, NoKey
from wyner.kme.identity import tls_context
from wyner.studies.fit.toml import as_toml

SAES: Final = {"controller": "alice", "plant": "bob"}
OTHER: Final = {"controller": "plant", "plant": "controller"}
RESTART_S: Final = 0.1


class Relay:
    """The field bus between two ends that are not connected: it loses, repeats and delays.

    Parameters
    ----------
    plant, controller : str
        Where each listens.
    loss, repeat : float
        Probability that a message vanishes, or arrives twice.
    delay_s : float
        Each arrival is late by a uniform time up to this, so messages overtake one another.
    seed : int
    """

    def __init__(
        self, plant: str, controller: str, loss: float, repeat: float, delay_s: float, seed: int
    ) -> None:
        self._buses = [ZenohBus(connect=[plant]), ZenohBus(connect=[controller])]
        self._draw = random.Random(seed)
        self._odds = loss, repeat, delay_s
        self.counts = {"passed": 0, "lost": 0, "repeated": 0}
        one, two = self._buses
        for kind, near, far in ((Measurement, one, two), (Offer, two, one), (Sealed, two, one)):
            key = key_of(kind, DEFAULT_LOOP)
            near.subscribe(key, partial(self._pass, far.publisher(key).put))

    def _pass(self, put: Callable[[bytes], None], _key: str, body: bytes, _t_ns: int) -> None:
        loss, repeat, delay_s = self._odds
        if self._draw.random() < loss:
            self.counts["lost"] += 1
            return
        twice = self._draw.random() < repeat
        self.counts["passed"] += 1
        self.counts["repeated"] += twice
        for _ in range(1 + twice):
            threading.Timer(self._draw.uniform(0.0, delay_s), self._put, (put, body)).start()

    @staticmethod
    def _put(put: Callable[[bytes], None], body: bytes) -> None:
        with suppress(TransportError):  # the relay has been closed
            put(body)

    def close(self) -> None:
        """Pass nothing on any more."""
        for bus in self._buses:
            bus.close()


@dataclass
class Campaign:
    """The four processes, and what was fetched from them."""

    folder: Path
    commands: dict[str, list[str]]
    ports: dict[str, int]
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    given: dict[str, dict[str, bytes]] = field(default_factory=lambda: {s: {} for s in SAES})
    """Of each side, the key of each id that its server has given."""

    problems: list[str] = field(default_factory=list)
    stopping: threading.Event = field(default_factory=threading.Event)
    sealing: threading.Event = field(default_factory=threading.Event)
    """Set while a sealed message is under way."""

    def start(self, name: str) -> None:
        """Start one process, or start it again."""
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", "wyner", *self.commands[name]], stdout=log, stderr=log
            )

    def kill(self, name: str) -> None:
        """Kill one process, and start it again."""
        self.processes[name].kill()
        self.processes[name].wait()
        time.sleep(RESTART_S)
        self.start(name)

    def client(self, side: str) -> KeyClient:
        """A side's own application at its own server."""
        tls = tls_context(self.folder / "certs" / SAES[side], server=False)
        return KeyClient("localhost", self.ports[side], tls)

    def fetch(self, side: str) -> None:
        """Fetch keys as a master, and each by its id at the other side, until stopped."""
        mine, theirs = self.client(side), self.client(OTHER[side])
        while not self.stopping.is_set():
            try:
                keys = mine.enc_keys(SAES[OTHER[side]], 2)
            except NoKey:
                time.sleep(0.05)
                continue
            for key in keys:
                self._note(side, key)
                for _ in range(3):
                    with suppress(NoKey):
                        (same,) = theirs.dec_keys(SAES[side], [key.key_id])
                        self._note(OTHER[side], same)
                        break

    def _note(self, side: str, key: Key) -> None:
        name, body = key
        if name in self.given[side]:
            self.problems.append(f"{side}: {name} was given twice")
        self.given[side][name] = body
        if self.given[OTHER[side]].get(name, body) != body:
            self.problems.append(f"{name} differs between the two sides")

    def send(self, ops: str, sent: list[str]) -> None:
        """Send sealed messages one after another until stopped."""
        while not self.stopping.is_set():
            name = f"m{len(sent)}"
            command = ["send", "--sealed", f"message {name}", "--id", name, "--timeout", "3"]
            self.sealing.set()
            done = subprocess.run(
                [sys.executable, "-m", "wyner", *command, "--connect", f"ops={ops}"],
                capture_output=True,
                check=False,
            )
            self.sealing.clear()
            if done.returncode == 0:
                sent.append(name)
            time.sleep(0.3)


def laid_out(folder: Path, *, relayed: bool, secret: bool) -> tuple[Campaign, dict[str, str]]:
    """The campaign's processes, none of them started, and the endpoints of plant and controller."""
    names = ("kme-controller", "kme-plant", *SAES.values())
    hosts = ["localhost", "127.0.0.1"]
    ensure_certificates(folder / "certs", dict.fromkeys(names, hosts), 2)
    field_plant, field_controller, ops_plant, ops_controller, *kmes = free_endpoints(6)
    ports = {side: int(end.rpartition(":")[2]) for side, end in zip(SAES, kmes, strict=True)}
    tables = tomllib.loads((SCENARIOS / "keys.toml").read_text(encoding="utf-8"))
    tables["keys"]["eps_E"] = 0.5  # short blocks, so that some close between two deaths
    (folder / "keys.toml").write_text(as_toml(tables), encoding="utf-8")
    common = ["--scenario", str(folder / "keys.toml"), "--run-dir", str(folder / "run")]
    commands = {
        "plant": [
            *("plant", *common, "--pace", "x20"),
            *("--listen", f"field={field_plant}", "--listen", f"ops={ops_plant}"),
        ],
        "controller": [
            *("controller", *common, "--listen", f"field={field_controller}"),
            *([] if relayed else ["--connect", f"field={field_plant}"]),
            *("--listen", f"ops={ops_controller}", "--connect", f"ops={ops_plant}"),
        ],
    }
    if secret:
        make_secret(folder / "secret-plant")
        shutil.copy(folder / "secret-plant", folder / "secret-controller")
        for side in SAES:
            commands[side] += ["--secret", str(folder / f"secret-{side}")]
    for side, sae in SAES.items():
        commands[f"kme-{side}"] = [
            *("kme", "--run-dir", str(folder / "run"), "--side", side, "--rate", "1000"),
            *("--tls", str(folder / "certs" / f"kme-{side}"), "--sae", sae),
            *("--partner-sae", SAES[OTHER[side]], "--listen", f"127.0.0.1:{ports[side]}"),
        ]
    ends = {"plant": field_plant, "controller": field_controller, "ops": ops_controller}
    return Campaign(folder, commands, ports), ends


def judged(campaign: Campaign, sent: Sequence[str]) -> dict[str, Any]:
    """What is in the two stores, beside what was fetched and sent."""
    run, problems = campaign.folder / "run", campaign.problems
    with (
        KeyStore(run / CONTROLLER_KEYS, "controller") as one,
        KeyStore(run / PLANT_KEYS, "plant") as two,
    ):
        mine, theirs = ([name for name, _ in store.ids()] for store in (one, two))
        shared = min(len(mine), len(theirs))
        if mine[:shared] != theirs[:shared]:
            problems.append("the two stores differ in ids or order")
        opened = [name for name, _ in SealedBook(two).opened()]
        states = [len(store.ids()) - store.counts().stored for store in (one, two)]
        dropped = [store.counts().dropped for store in (one, two)]
        pads = {side: tuple(counts) for side, counts in pad_counts(one).items()}
    if len(set(opened)) != len(opened):
        problems.append("a sealed message was opened twice")
    if opened[: len(sent)] != list(sent):
        problems.append(f"sealed messages: {sent} were acknowledged, {opened} opened")
    both = set(campaign.given["controller"]) & set(campaign.given["plant"])
    return {
        "keys_made": [len(mine), len(theirs)],
        "confirmed_or_later": states,
        "dropped": dropped,
        "pads_made_spent_left": pads,
        "keys_given": {side: len(keys) for side, keys in campaign.given.items()},
        "keys_given_at_both_ends": len(both),
        "sealed_messages": len(sent),
        "problems": problems,
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Kill, and say what is left; exit code 1 where something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tools.kill_keys", description=__doc__)
    parser.add_argument("--kills", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of victims and moments")
    parser.add_argument("--loss", type=float, default=0.0, metavar="P", help="messages lost")
    parser.add_argument("--repeat", type=float, default=0.0, metavar="P", help="messages repeated")
    parser.add_argument("--delay", type=float, default=0.0, metavar="S", help="seconds at most")
    parser.add_argument("--secret", action="store_true", help="sign key blocks")
    args = parser.parse_args(argv)
    draw = random.Random(args.seed)
    odds = args.loss, args.repeat, args.delay
    with tempfile.TemporaryDirectory() as folder:
        campaign, ends = laid_out(Path(folder), relayed=any(odds), secret=args.secret)
        relay = Relay(ends["plant"], ends["controller"], *odds, args.seed) if any(odds) else None
        sent: list[str] = []
        threads = [threading.Thread(target=campaign.fetch, args=(side,)) for side in SAES]
        threads.append(threading.Thread(target=campaign.send, args=(ends["ops"], sent)))
        begin = time.monotonic()
        kills = dict.fromkeys(campaign.commands, 0)
        while_sealing = 0
        try:
            for name in campaign.commands:
                campaign.start(name)
            for thread in threads:
                thread.start()
            time.sleep(3.0)
            for number in range(args.kills):
                victim = draw.choice(list(campaign.commands))
                if number % 2:  # while a message is taken, sealed, repeated, opened or acknowledged
                    campaign.sealing.wait(5.0)
                    time.sleep(draw.uniform(0.0, 1.0))
                while_sealing += campaign.sealing.is_set()
                campaign.kill(victim)
                kills[victim] += 1
                # Most deaths soon after one another, some after a time in which blocks close.
                time.sleep(draw.uniform(2.0, 4.0) if number % 5 == 4 else draw.uniform(0.1, 0.8))
            time.sleep(6.0)
        finally:
            campaign.stopping.set()
            for thread in threads:
                if thread.ident is not None:
                    thread.join()
            for process in campaign.processes.values():
                process.terminate()
            for process in campaign.processes.values():
                process.wait(20)
            if relay is not None:
                relay.close()
        result = judged(campaign, sent)
    if relay is not None:
        result["relay"] = relay.counts
    result |= {"kills_while_sealing": while_sealing}
    result |= {"kills": kills, "seconds": round(time.monotonic() - begin), "seed": args.seed}
    print(json.dumps(result, indent=2))
    return 1 if result["problems"] else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    sys.exit(main())
