"""SIGKILL and SIGSTOP of live services: ``python -m tests.campaigns.kills --kills 1000``.

Each run is a whole loop of processes: controller, plant, tap, and in every other run a
router. Any of them is killed at random instants and started again, or frozen for up to six
seconds, while others are killed; :mod:`tests.campaigns.judged` says what must have come of it.
With ``--tls`` there is always a router, which lets in whoever has a certificate,
and each publish what its name allows. With ``--keys`` the field bus goes through a relay that
loses, repeats and delays. With ``--watched`` the
coin is keyed and the loop is in lock-step: no honest step may alarm. With ``--sealed`` the messages
travel under the key stream, in lock-step too.
"""

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Final

from tests.campaigns.judged import judged
from tests.campaigns.live import LiveLoop, Process, plain_text
from tests.campaigns.progress import Progress, arguments

KILLS_A_RUN: Final = 60
BYTES_A_KILL: Final = 30
RELAYED_BYTES_A_KILL: Final = 12
"""Bytes of a short run's message, so that it lasts as long as the kills; fewer through the relay,
where the loop is the slower."""

FROZEN_S: Final = 6.0
RELAY: Final = (0.02, 0.05, 0.001)
"""Its odds: loss, repeat, and the longest delay in seconds."""

SERVICES: Final = ("controller", "plant", "tap", "router", "relay")
KINDS: Final = {
    "tls": "a router that asks for certificates",
    "keys": "a relay",
    "watched": "the coin is keyed",
    "sealed": "messages travel under the key stream",
}

PACES: Final = ("fast", "x100", "x20")

RELAYED_PACE: Final = "x5"
"""Through the relay a loop of x20 misses nine steps in ten, and one of x5 hardly any."""


class Reaper:
    """Kills and freezes services at instants of its choice."""

    def __init__(self, loop: LiveLoop, draw: random.Random) -> None:
        self.loop, self.draw = loop, draw
        self.counts: Counter[str] = Counter()
        self._thaw: dict[str, float] = {}
        self._back: dict[str, float] = {}

    def strike(self) -> None:
        """One more blow, and whatever is due of the earlier ones."""
        draw, now = self.draw, time.monotonic()
        name = draw.choice(sorted(self.loop.processes))
        process = self.loop.processes[name]
        if process.alive():
            frozen = name in self._thaw
            if draw.random() < 0.85:
                process.kill()
                self.counts[name] += 1
                self.counts["killed while frozen"] += frozen
                self.counts["killed while another is frozen"] += bool(self._thaw) and not frozen
                self._thaw.pop(name, None)
                self._back[name] = now + draw.choice((0.0, draw.uniform(0.0, 0.5)))
            elif not frozen:
                process.signal(signal.SIGSTOP)
                self.counts["frozen"] += 1
                self._thaw[name] = now + draw.uniform(0.05, FROZEN_S)
        self.mend()

    def mend(self, *, all_of_it: bool = False) -> list[str]:
        """Start and thaw what is due; who ended by itself."""
        now = float("inf") if all_of_it else time.monotonic()
        wrong = []
        for name, process in self.loop.processes.items():
            if name in self._thaw and self._thaw[name] <= now:
                process.signal(signal.SIGCONT)
                del self._thaw[name]
            if not process.alive() and self._back.get(name, 0.0) <= now:
                if process.ended and process.ended[-1] >= 0:
                    said = self.loop.last_line(name)
                    wrong.append(f"{name}: ended by itself, code {process.ended[-1]}: {said}")
                process.start()
        return wrong


def one_run(
    seed: int, folder: Path, kills: int, kind: str = "kills"
) -> tuple[Counter[str], list[str]]:
    """Kill and freeze; how often, and what was wrong. ``kind``: ``kills``, or of :data:`KINDS`."""
    draw = random.Random(seed)
    relayed, lock_step = kind == "keys", kind in ("watched", "sealed")
    bytes_a_kill = RELAYED_BYTES_A_KILL if relayed else BYTES_A_KILL
    text = plain_text(draw, min(200, bytes_a_kill * kills))
    loop = LiveLoop(
        folder,
        text.encode(),
        pace="fast" if lock_step else RELAYED_PACE if relayed else draw.choice(PACES),
        router=kind == "tls" or (not relayed and seed % 2 == 1),
        tls=kind == "tls",
        relay=RELAY if relayed else None,
        scenario=kind if lock_step else "keys",
    )
    reaper = Reaper(loop, draw)
    counts, wrong = reaper.counts, list[str]()
    expected, operators = [text], list[Process]()
    loop.start()
    try:
        time.sleep(draw.uniform(0.5, 1.5))
        while sum(counts[name] for name in loop.processes) < kills and not wrong:
            reaper.strike()
            wrong += reaper.mend()
            if draw.random() < 0.05 and len(operators) < 20:
                name = f"message-{len(operators)}"
                expected.append(plain_text(draw, 12))
                operators.append(loop.send(name, expected[-1]))
            time.sleep(draw.choice((0.0, draw.uniform(0.0, 0.5))))
        reaper.mend(all_of_it=True)
        wrong += loop.deliver_all(operators, len(expected))
    finally:
        wrong += loop.stop()
        for operator in operators:
            operator.kill()
    return counts, wrong + judged(loop.run_dir, expected, counts)


def main(argv: list[str] | None = None) -> int:
    """Run after run; 1 when something was wrong."""
    parser = arguments(__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--failed", type=Path, default=Path("campaign-failed"), metavar="FOLDER")
    kind = parser.add_mutually_exclusive_group()
    for name, what in KINDS.items():
        kind.add_argument(f"--{name}", dest="kind", action="store_const", const=name, help=what)
    parser.set_defaults(kind="kills")
    args = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    done = Counter[str]()
    progress = Progress(args.seconds, lambda: dict(done))
    while (killed := sum(done[name] for name in SERVICES)) < args.kills:
        seed = args.seed + done["runs"]
        with tempfile.TemporaryDirectory() as folder:
            kills = min(KILLS_A_RUN, args.kills - killed)
            counts, wrong = one_run(seed, Path(folder), kills, args.kind)
            if wrong:
                print(f"run {seed}:", *wrong, sep="\n  ")
                shutil.copytree(folder, args.failed / f"{args.kind}-{seed}")
        done.update(counts, runs=1, wrong=int(bool(wrong)))
        print(json.dumps(done), flush=True)
        if not progress.goes_on():
            break
    return int(done["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
