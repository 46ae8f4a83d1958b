"""Does an answer take longer when it carries a message symbol? ``python -m benchmarks.timing``.

A tap sees when messages pass. So the time from a message's arrival at either end to its answer on
the way, journal included, must not depend on the automaton's state. Both ends run in one process
with real journals and traces. The two states' times are compared by Yuen's test (trimmed means),
and the same is measured again with a wait of one microsecond added in one state: a test that does
not see that has no power, and says so.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from protocol.link.endpoint import Outgoing
from protocol.messages import FIELD

if TYPE_CHECKING:
    from protocol.link.endpoint import Endpoint, Notice, Write
    from protocol.link.events import Event
    from protocol.messages import Message
    from protocol.runtime.ports import Files
    from protocol.secret.tasks import Task

TRIM: Final = 0.2
"""Share of the times that is left out at each end: a scheduler's, and not the program's."""

SURE: Final = 3.29
"""Standard errors beyond which a difference is one, at one in a thousand."""

CONTROL_NS: Final = 1000
"""What the control adds where a message symbol is carried."""

WARM_UP: Final = 0.1
"""Share of the steps that is not looked at."""


class Difference(NamedTuple):
    """How much longer the second sample's trimmed mean is, and its standard error."""

    ns: float
    error_ns: float

    @property
    def seen(self) -> bool:
        """Whether it is more than chance."""
        return abs(self.ns) > SURE * self.error_ns

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return {"ns": self.ns, "error_ns": self.error_ns, "seen": self.seen}


def difference(first: Sequence[float], second: Sequence[float]) -> Difference:
    """Yuen's comparison of two samples (Biometrika 61, 1974).

    Raises
    ------
    ValueError
        When a sample has fewer than ten values.
    """
    means, variances = [], []
    for sample in (first, second):
        n, cut = len(sample), int(TRIM * len(sample))
        if n < 10:
            raise ValueError(f"expected ten values at least, got {n}")
        values = np.sort(np.asarray(sample, dtype=float))
        inner = values[cut : n - cut]
        winsorised = np.clip(values, inner[0], inner[-1])
        h = len(inner)
        means.append(float(inner.mean()))
        variances.append(float(winsorised.var(ddof=1)) * (n - 1) / (h * (h - 1)))
    return Difference(means[1] - means[0], math.sqrt(sum(variances)))


class _Ports:
    """A service's ports; notes when a field message leaves."""

    def __init__(self, partner: "list[Outgoing]", files: "Files") -> None:
        self.files = files
        self.left_ns = 0
        self._partner = partner

    def write(self, write: "Write") -> None:
        """Keep it in the journal."""
        self.files.journal.write(write)

    def publish(self, kind: "type[Message]", payload: bytes) -> None:
        """Leave it for the partner."""
        if kind in FIELD:
            self.left_ns = time.perf_counter_ns()
        self._partner.append(Outgoing(kind, payload))

    def keep(self, task: "Task") -> None:
        """Hand it to the keeper's thread."""
        raise AssertionError(f"this scenario makes no keys: {task}")

    def trace(self, event: "Event") -> None:
        """Write it to the trace."""
        self.files.trace.write(event.as_event())

    def tell(self, notice: "Notice") -> None:
        """Nobody reads the log."""

    def health(self, status: bytes) -> None:
        """Nobody asks for the health."""


Samples = dict[tuple[str, bool], list[int]]


def response_times(steps: int, added_ns: int = 0) -> Samples:
    """Nanoseconds of each answer, by side and by whether a message symbol is carried there.

    ``added_ns`` is waited, by the clock, before an answer that belongs to a carried symbol.
    """
    from controller_service.endpoint import ControllerEndpoint
    from controller_service.laws.registry import cached_design, make_law
    from plant_service.from_journal import plant_endpoint
    from protocol.agreement import NO_SYMBOL
    from protocol.link.pacing import Pacing
    from protocol.link.perform import perform
    from protocol.link.sender import Sender
    from protocol.link.session import rules_of
    from protocol.runtime.journal import ControllerJournal, PlantJournal
    from protocol.runtime.ports import Files
    from protocol.runtime.process import new_id
    from protocol.runtime.run_folder import CONTROLLER_JOURNAL, PLANT_JOURNAL
    from protocol.runtime.trace import TraceWriter
    from protocol.scenario import load_scenario
    from protocol.shipped import SCENARIOS
    from protocol.streams import CIPHER, COIN, noise, symbols

    scenario = load_scenario(SCENARIOS / "sustained.toml")
    law = make_law(scenario, cached_design(scenario))
    rules = rules_of(scenario)
    times: Samples = {(s, c): [] for s in ("controller", "plant") for c in (False, True)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        queue = ControllerJournal(folder / CONTROLLER_JOURNAL, rules.fingerprint)
        journal = PlantJournal(folder / PLANT_JOURNAL, rules.fingerprint)
        sender = Sender(rules, law.candidates, queue, symbols(None, CIPHER), new_id())
        controller = ControllerEndpoint(sender, queue, 0.1, message=b"x" * 60_000)
        now = time.monotonic()
        pacing = Pacing(None, scenario.link.repeats_per_period, now)
        coins, disturbances = symbols(None, COIN), noise(None, scenario.n)
        plant = plant_endpoint(scenario, journal, coins, disturbances, new_id, now, pacing)
        mail: dict[str, list[Outgoing]] = {"controller": [], "plant": []}
        ends: list[tuple[str, Endpoint, _Ports]] = []
        for name, partner, end, kept in (
            ("controller", "plant", controller, queue),
            ("plant", "controller", plant, journal),
        ):
            trace = TraceWriter(folder / f"{name}.jsonl", name, {})
            ends.append((name, end, _Ports(mail[partner], Files(kept, trace, folder))))
        for _side, endpoint, ports in ends:
            perform(endpoint.start(now), endpoint, ports)
        receiver = plant.plant.receiver
        while receiver.record.k < steps:
            for side, endpoint, ports in ends:
                now = time.monotonic()
                if endpoint.wake_at() <= now:
                    perform(endpoint.wake(now), endpoint, ports)
                heard, mail[side][:] = mail[side][:], []
                for kind, payload in heard:
                    state = receiver.record.state if side == "plant" else sender.record.state
                    carries = rules.scheme.pad(state) != NO_SYMBOL
                    k, ports.left_ns = receiver.record.k, 0
                    began = time.perf_counter_ns()
                    if added_ns and carries:
                        while time.perf_counter_ns() < began + added_ns:
                            pass
                    actions = endpoint.receive(kind, payload, now)
                    perform(actions._replace(settle=False), endpoint, ports)
                    if ports.left_ns and kind in FIELD and k > WARM_UP * steps:
                        times[side, carries].append(ports.left_ns - began)
                    if actions.settle:
                        perform(endpoint.settle(), endpoint, ports)
        for _side, _endpoint, ports in ends:
            ports.files.close()
    return times


def measure(steps: int = 100_000) -> dict[str, Any]:
    """Both ends' difference between the states, and the same with the control.

    Returns
    -------
    dict
        For each side: ``plain`` and ``control`` (:class:`Difference`), ``median_us``, ``answers``,
        and ``powered``: whether the control's microsecond was seen.
    """
    plain, control = response_times(steps), response_times(steps, CONTROL_NS)
    told: dict[str, Any] = {"steps": steps, "trim": TRIM, "sure": SURE}
    for side in ("controller", "plant"):
        found = difference(plain[side, False], plain[side, True])
        checked = difference(control[side, False], control[side, True])
        told[side] = {
            "plain": found.as_json(),
            "control": checked.as_json(),
            "powered": checked.seen and checked.ns > 0,
            "median_us": float(np.median(plain[side, False])) / 1e3,
            "answers": [len(plain[side, False]), len(plain[side, True])],
        }
    return told


def render(told: dict[str, Any]) -> str:
    """For people."""
    lines = []
    for side in ("controller", "plant"):
        r = told[side]
        p, c = r["plain"], r["control"]
        verdict = "a difference" if p["seen"] else "no difference seen"
        power = "saw" if r["powered"] else "DID NOT SEE"
        lines.append(
            f"{side}: median {r['median_us']:.1f} us; carrying takes {p['ns']:+.0f} ns longer "
            f"(standard error {p['error_ns']:.0f}): {verdict}; the control {power} its microsecond "
            f"({c['ns']:+.0f} ns, standard error {c['error_ns']:.0f})"
        )
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Measure; 1 when a difference was seen, 2 when the test had no power."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    told = measure(args.steps)
    print(json.dumps(told) if args.json else render(told))
    sides = [told[side] for side in ("controller", "plant")]
    if any(side["plain"]["seen"] for side in sides):
        return 1
    return 0 if all(side["powered"] for side in sides) else 2


if __name__ == "__main__":
    sys.exit(main())
