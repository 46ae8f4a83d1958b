"""A long run that makes keys: ``python -m tests.campaigns.endurance --steps 100000``.

`wyner up` on the scenario `keys` in lock-step, with signed blocks. Twice a second each service's
memory and what is left in the ledger of pads are noted. At the end: memory by fifths of the run,
the fewest pads ever left, steps a second early and late, the keys at both ends, and whether
`wyner check` passes.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from protocol.secret.records import StoreError
from runtime.keys.ledger import pad_counts
from runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS, PLANT_STATUS
from tests.system.test_integration import children_of
from wyner.runs.check import check
from wyner.runs.check.evidence import read_evidence

LOOK_S = 0.5
GROWTH_MIB = 8.0
"""More than this from the third fifth to the last is called growth; before, caches fill."""


def rss_mib(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS:"))


def look(pid: int, run_dir: Path, begun_s: float) -> dict[str, Any] | None:
    """Memory, pads and steps at this moment; None while the services start or end."""
    try:
        memory = {name: rss_mib(child) for name, child in children_of(pid).items()}
        pads = [pad_counts(run_dir / path) for path in (CONTROLLER_KEYS, PLANT_KEYS)]
        status = json.loads((run_dir / PLANT_STATUS).read_bytes())
    except (OSError, ValueError, StoreError, StopIteration):
        return None
    if len(memory) < 3 or status["k"] < 1:
        return None
    fewest = min((one.left for one in pads if one is not None), default=0)
    return {"s": time.monotonic() - begun_s, "k": status["k"], "pads": fewest, "mib": memory}


def judged(looks: list[dict[str, Any]], summary: dict[str, Any]) -> dict[str, Any]:
    """The figures, and what is wrong with them."""
    size = len(looks) // 5
    fifths = [looks[i * size : (i + 1) * size] for i in range(5)]
    memory = {
        name: [round(statistics.median(one["mib"][name] for one in part), 1) for part in fifths]
        for name in looks[0]["mib"]
    }
    pace = [
        round((part[-1]["k"] - part[0]["k"]) / (part[-1]["s"] - part[0]["s"]))
        for part in (fifths[1], fifths[-1])
    ]
    keys = summary["keys"]
    fewest = min(one["pads"] for one in looks)
    grown = {n: (m[-3], m[-1]) for n, m in memory.items() if m[-1] - m[-3] > GROWTH_MIB}
    wrong = [f"{name} grew from {a} to {b} MiB" for name, (a, b) in grown.items()]
    wrong += ["the ledger was empty"] * (fewest == 0)
    wrong += ["the two stores differ"] * (not keys["same_at_both_ends"])
    wrong += [f"she holds {keys['held_by_tap_bits']} bits"] * bool(keys["held_by_tap_bits"])
    return {
        "mib_by_fifths": memory,
        "steps_per_second_early_and_late": pace,
        "fewest_pads_left": fewest,
        "keys": {k: keys[k] for k in ("made", "blocks", "held_by_tap_bits", "missed_by_tap")},
        "last_block_bits_per_second": keys["last_block_bits_per_second"],
        "wrong": wrong,
    }


def main(argv: list[str] | None = None) -> int:
    """Run, and say what was seen; 1 when something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        run_dir = Path(name) / "run"
        command = [
            sys.executable,
            "-m",
            "wyner",
            "up",
            "--scenario",
            "keys",
            "--pace",
            "fast",
            "--steps",
            str(args.steps),
            "--secret",
            "--eavesdropper",
            "nearest-centre",
            "--json",
            "--run-dir",
            str(run_dir),
        ]
        begun_s = time.monotonic()
        looks: list[dict[str, Any]] = []
        with (Path(name) / "out").open("wb+") as out:
            process = subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL)
            try:
                while process.poll() is None:
                    time.sleep(LOOK_S)
                    seen = look(process.pid, run_dir, begun_s)
                    looks += [] if seen is None else [seen]
            finally:
                process.terminate()
                process.wait()
            out.seek(0)
            summary = json.loads(out.read())
        if len(looks) < 10:
            parser.error(f"--steps: got {args.steps}, expected more: {len(looks)} looks were taken")
        result = judged(looks, summary)
        results = check(read_evidence(run_dir))
        result["wrong"] += [f"{r.clause.name} fails" for r in results if r.result == "FAIL"]
    print(json.dumps({"steps": args.steps, "looks": len(looks), **result}, indent=1))
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
