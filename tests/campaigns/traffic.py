"""What goes over a live loop while it is ill-treated, and what must have come of it at the end.

Every message must be there once, no key may have been given out twice, every service must end with
code 0 when it is asked to, and `wyner check` must pass.
"""

import base64
import multiprocessing
import random
import time
from collections import Counter
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from protocol.secret.records import StoreError
from runtime.keys.sealed_book import SealedBook
from runtime.keys.store import KeyStore
from runtime.recording import TraceError
from runtime.run_folder import PLANT_KEYS
from tests.campaigns.live import LiveLoop, Process, all_done, plain_text, wait_for
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence
from wyner.runs.run import Run, RunError

AT_LAST_S: Final = 120.0
"""Seconds that a loop has to deliver what is queued, once all is well."""


class Customer:
    """Two applications that fetch keys whenever the servers are there, and note what they got.

    They are a process of their own: who forks services must not have a second thread, or a child
    may be born with a lock that nobody gives back.
    """

    def __init__(self, loop: LiveLoop) -> None:
        self.sites = loop.sites
        self.got: dict[str, list[tuple[str, str]]] = {"alice": [], "bob": []}
        self.wrong: list[str] = []
        fork = multiprocessing.get_context("fork")
        self.over = fork.Event()
        self._told, theirs = fork.Pipe()
        self._process = fork.Process(target=self._run, args=(theirs,), daemon=True)

    def start(self) -> None:
        """Begin to fetch."""
        self._process.start()

    def stop(self) -> None:
        """Fetch no more; take what was noted."""
        self.over.set()
        if self._told.poll(60):
            self.got, self.wrong = self._told.recv()
        else:
            self.wrong.append("the applications do not end")
        self._process.join(10)

    def _run(self, told: Connection) -> None:
        """Fetch until told that it is over."""
        while not self.over.wait(0.05):
            for key_id, key in self._ask("controller", "alice", "bob/enc_keys"):
                self.got["alice"].append((key_id, key))
                for same in self._ask("plant", "bob", f"alice/dec_keys?key_ID={key_id}"):
                    self.got["bob"].append(same)
                    if same != (key_id, key):
                        self.wrong.append(f"key {key_id} differs")
        told.send((self.got, self.wrong))

    def _ask(self, side: str, name: str, path: str) -> list[tuple[str, str]]:
        with suppress(OSError, ValueError, AssertionError, KeyError):
            code, told = self.sites.ask(side, name, f"/api/v1/keys/{path}")
            if code == 200:
                return [(k["key_ID"], k["key"]) for k in told["keys"]]
        return []

    def judged(self) -> list[str]:
        """What was wrong with the keys."""
        for name, got in self.got.items():
            for what, place in (("id", 0), ("key", 1)):
                seen = Counter(one[place] for one in got)
                self.wrong += [f"{name} got {what} {x} twice" for x, n in seen.items() if n > 1]
        return self.wrong


class Traffic:
    """A loop that runs inside ``with``, its messages and its customer.

    Attributes
    ----------
    expected : list of str
        Every message that must arrive once, the controller's first among them.
    sealed : dict of str to str
        Every sealed one, by its identifier.
    wrong : list of str
        What was wrong, in a line each.
    """

    def __init__(self, loop: LiveLoop, first: str, draw: random.Random) -> None:
        self.loop, self.expected, self.draw = loop, [first], draw
        self.sealed: dict[str, str] = {}
        self.wrong: list[str] = []
        self.operators: list[Process] = []
        self.customer = Customer(loop)

    def __enter__(self) -> "Traffic":
        self.customer.start()
        self.loop.start()
        return self

    def send(self, *, sealed: bool = False) -> None:
        """Hand over one message more."""
        name, text = f"message-{len(self.operators)}", plain_text(self.draw, 12)
        if sealed:
            self.sealed[name] = text
        else:
            self.expected.append(text)
        self.operators.append(self.loop.send(name, text, sealed=sealed))

    def arrive(self) -> None:
        """All is well now: wait until every message has arrived; no key goes elsewhere."""
        self.customer.over.set()
        if not wait_for(lambda: all_done(self.operators), AT_LAST_S):
            self.wrong.append("an operator has no answer")
        well = self.loop.mark()
        if not wait_for(lambda: self.loop.delivered(well) == len(self.expected), AT_LAST_S):
            self.wrong.append(f"{self.loop.delivered(well)} messages arrive although all is well")
        self.loop.start()
        time.sleep(0.5)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.customer.stop()
        self.wrong += self.loop.stop()
        for operator in self.operators:
            operator.kill()

    def judged(self, counts: Counter[str]) -> list[str]:
        """What was wrong with a run that is over; adds its figures to ``counts``."""
        counts["messages"], counts["sealed"] = len(self.expected), len(self.sealed)
        counts["keys"] = len(self.customer.got["alice"])
        run_dir = self.loop.run_dir
        self.wrong += self.customer.judged()
        try:
            self.wrong += _recovered(run_dir, self.expected, counts)
            if self.sealed:
                self.wrong += _opened(run_dir, self.sealed)
            self.wrong += _watched(run_dir, counts)
            evidence = read_evidence(run_dir)
            results = check(evidence)
        except (OSError, RunError, StoreError, TraceError, ValueError) as error:
            return [*self.wrong, f"the run cannot be read: {error}"]
        plant = evidence.plant
        counts["transitions"] = 0 if plant is None else sum(plant.transitions.values())
        failed = [f"{r.check.name}: {r.counter.first}" for r in results if r.result == "FAIL"]
        return self.wrong + failed


def _watched(run_dir: Path, counts: Counter[str]) -> list[str]:
    """Steps that a key watched, and what honest steps and messages must not do."""
    told: Counter[str] = Counter()

    def note(event: dict[str, Any]) -> None:
        told[event["event"]] += 1
        told["watched"] += event.get("expected", -1) != -1 and event["event"] == "transition"

    Run.load(run_dir).feed("controller", note)
    Run.load(run_dir).feed("plant", lambda event: told.update(forged=event["event"] == "forged"))
    counts["watched"] = told["watched"]
    return [
        f"{told[event]} honest {what}"
        for event, what in (("alarm", "steps made an alarm"), ("forged", "messages were refused"))
        if told[event]
    ]


def _recovered(run_dir: Path, expected: list[str], counts: Counter[str]) -> list[str]:
    told: list[dict[str, Any]] = []
    Run.load(run_dir).feed("plant", told.append)
    events = [e for e in told if e["event"] in ("recovered", "session")]
    got = [base64.b64decode(e["payload"]).decode() for e in events if e["event"] == "recovered"]
    counts["sessions"] = len({e["session"] for e in events if e["event"] == "session"})
    seen = Counter(got)
    wrong = [
        f"{text[:20]!r} was recovered {seen[text]} times" for text in expected if seen[text] != 1
    ]
    return wrong + [f"{text[:20]!r} was never sent" for text in seen if text not in expected]


def _opened(run_dir: Path, sealed: dict[str, str]) -> list[str]:
    with KeyStore(run_dir / PLANT_KEYS, "plant") as store:
        opened = [(name, payload.decode()) for name, payload in SealedBook(store).opened()]
    if sorted(opened) == sorted(sealed.items()):
        return []
    return [f"sealed messages: {sorted(sealed)} were acknowledged, {sorted(opened)} opened"]
