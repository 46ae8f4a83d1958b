"""Kill -9 of controller, plant and both key servers, again and again, while keys are fetched.

At the end both stores must hold the same keys under the same ids in the same order, no key may have
been delivered twice at a side, each key must be the same at both ends, and every sealed message
must have been opened once and in order. Run it with ``python -m tools.kill_keys --kills 200``.
"""

import argparse
import http.client
import json
import os
import random
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from protocol.runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from protocol.runtime.zenoh_bus import free_endpoints
from protocol.secret.sealed_book import SealedBook
from protocol.secret.store import KeyStore
from protocol.shipped import SCENARIOS
from wyner.deployment.certificates import ensure_certificates

SAES: Final = {"controller": "alice", "plant": "bob"}
OTHER: Final = {"controller": "plant", "plant": "controller"}
RESTART_S: Final = 0.1


@dataclass
class Campaign:
    """The four processes, and what was fetched from them."""

    folder: Path
    commands: dict[str, list[str]]
    ports: dict[str, int]
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    given: dict[str, dict[str, str]] = field(default_factory=lambda: {s: {} for s in SAES})
    """Of each side, the key of each id that its server has given."""

    problems: list[str] = field(default_factory=list)
    stopping: threading.Event = field(default_factory=threading.Event)

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

    def ask(self, side: str, path: str) -> Any:
        """What a side's server answers to its own application; None where it does not."""
        certs = self.folder / "certs"
        tls = ssl.create_default_context(cafile=str(certs / "ca.pem"))
        mine = certs / SAES[side]
        tls.load_cert_chain(mine / "cert.pem", mine / "key.pem")
        connection = http.client.HTTPSConnection(
            "localhost", self.ports[side], context=tls, timeout=5
        )
        try:
            with closing(connection):
                connection.request("GET", f"/api/v1/keys/{SAES[OTHER[side]]}/{path}")
                answer = connection.getresponse()
                told = json.loads(answer.read())
                return told["keys"] if answer.status == 200 else None
        except (OSError, http.client.HTTPException, ValueError):
            return None

    def fetch(self, side: str) -> None:
        """Fetch keys as a master, and each by its id at the other side, until stopped."""
        while not self.stopping.is_set():
            keys = self.ask(side, "enc_keys?number=2")
            if keys is None:
                time.sleep(0.05)
                continue
            for key in keys:
                self._note(side, key)
                for _ in range(3):
                    (theirs,) = self.ask(OTHER[side], f"dec_keys?key_ID={key['key_ID']}") or [None]
                    if theirs is not None:
                        self._note(OTHER[side], theirs)
                        break

    def _note(self, side: str, key: dict[str, str]) -> None:
        name, body = key["key_ID"], key["key"]
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
            done = subprocess.run(
                [sys.executable, "-m", "wyner", *command, "--connect", f"ops={ops}"],
                capture_output=True,
                check=False,
            )
            if done.returncode == 0:
                sent.append(name)


def laid_out(folder: Path) -> tuple[Campaign, str]:
    """The campaign's processes, none of them started, and the controller's endpoint on ops."""
    names = ("kme-controller", "kme-plant", *SAES.values())
    hosts = ["localhost", "127.0.0.1"]
    ensure_certificates(folder / "certs", dict.fromkeys(names, hosts), 2)
    field_end, ops_plant, ops_controller, kme_one, kme_two = free_endpoints(5)
    ports = {
        side: int(end.rpartition(":")[2])
        for side, end in zip(SAES, (kme_one, kme_two), strict=True)
    }
    common = ["--scenario", str(SCENARIOS / "keys.toml"), "--run-dir", str(folder / "run")]
    commands = {
        "plant": [
            *("plant", *common, "--pace", "x20"),
            *("--listen", f"field={field_end}", "--listen", f"ops={ops_plant}"),
        ],
        "controller": [
            *("controller", *common, "--connect", f"field={field_end}"),
            *("--listen", f"ops={ops_controller}", "--connect", f"ops={ops_plant}"),
        ],
    }
    for side, sae in SAES.items():
        commands[f"kme-{side}"] = [
            *("kme", "--run-dir", str(folder / "run"), "--side", side, "--rate", "1000"),
            *("--tls", str(folder / "certs" / f"kme-{side}"), "--sae", sae),
            *("--partner-sae", SAES[OTHER[side]], "--listen", f"127.0.0.1:{ports[side]}"),
        ]
    return Campaign(folder, commands, ports), ops_controller


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
    if len(set(opened)) != len(opened):
        problems.append("a sealed message was opened twice")
    if opened[: len(sent)] != list(sent):
        problems.append(f"sealed messages: {sent} were acknowledged, {opened} opened")
    both = set(campaign.given["controller"]) & set(campaign.given["plant"])
    return {
        "keys_made": [len(mine), len(theirs)],
        "confirmed_or_later": states,
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
    args = parser.parse_args(argv)
    draw = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        campaign, ops = laid_out(Path(folder))
        sent: list[str] = []
        threads = [threading.Thread(target=campaign.fetch, args=(side,)) for side in SAES]
        threads.append(threading.Thread(target=campaign.send, args=(ops, sent)))
        begin = time.monotonic()
        kills = dict.fromkeys(campaign.commands, 0)
        try:
            for name in campaign.commands:
                campaign.start(name)
            for thread in threads:
                thread.start()
            time.sleep(3.0)
            for number in range(args.kills):
                victim = draw.choice(list(campaign.commands))
                campaign.kill(victim)
                kills[victim] += 1
                # Most deaths soon after one another, some after a time in which blocks close.
                time.sleep(draw.uniform(2.0, 4.0) if number % 10 == 9 else draw.uniform(0.1, 0.8))
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
        result = judged(campaign, sent)
    result |= {"kills": kills, "seconds": round(time.monotonic() - begin), "seed": args.seed}
    print(json.dumps(result, indent=2))
    return 1 if result["problems"] else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONUNBUFFERED", "1")
    sys.exit(main())
