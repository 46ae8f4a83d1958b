"""Speed, watched: ratios by version in ``record.json``, and whether one has fallen since.

A ratio is of two things measured side by side in one run, so that it says little of the machine.
Each comes with one figure a round, which tell how noisy it was.
"""

import json
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

RECORD: Final = Path(__file__).with_name("record.json")

LEAST: Final = 0.05
"""A ratio that is lower by less than this part has not fallen, however quiet it was."""

SURE: Final = 3.0
"""Standard errors of the difference beyond which it is no chance."""

WATCHED: Final[dict[str, tuple[str, Callable[[dict[str, Any]], Sequence[float] | None]]]] = {
    "loop": (
        "control steps for each bare round trip",
        lambda r: [one["ratio"] for one in r["rounds"]],
    ),
    "engine": ("engine's steps for each of the plain loop", lambda r: r["ratios"]),
    "keys": (
        "steps with keys for each without",
        lambda r: [o["on"] / o["off"] for o in r["rounds"]],
    ),
    "sets": ("the polytope package's time for ours", lambda r: r.get("ratios")),
}
"""Benchmark, what its ratio says (more is better), and the ratio of each round in its result."""


class Fall(NamedTuple):
    """A ratio then and now, as medians; ``noise`` is the part by which it may differ by chance."""

    before: float
    now: float
    noise: float

    @property
    def part(self) -> float:
        """By which part it is lower, below zero where it is higher."""
        return 1 - self.now / self.before

    @property
    def fell(self) -> bool:
        """Whether it is lower by more than its noise."""
        return self.part > self.noise


def standard_error(rounds: Sequence[float]) -> float:
    """Of a median, from the range of a few values (normal: E[range] / sigma, and sqrt(pi / 2))."""
    n = len(rounds)
    if n < 2:
        return math.inf
    width = statistics.NormalDist()
    # Blom's score of the largest of n: half the range that is expected, in standard deviations
    sigma = (max(rounds) - min(rounds)) / (2 * width.inv_cdf((n - 0.375) / (n + 0.25)))
    return math.sqrt(math.pi / 2) * sigma / math.sqrt(n)


def compare(before: Sequence[float], now: Sequence[float]) -> Fall:
    """Compare two measurements of a ratio, a figure a round."""
    then, this = statistics.median(before), statistics.median(now)
    error = math.hypot(standard_error(before), standard_error(now))
    return Fall(then, this, max(LEAST, SURE * error / then))


Entry = dict[str, Any]


def read(path: Path = RECORD) -> list[Entry]:
    """The entries, oldest first; none where there is no record.

    Raises
    ------
    ValueError
        When it is no record.
    """
    if not path.exists():
        return []
    entries = json.loads(path.read_text())
    if not isinstance(entries, list) or not all("ratios" in e and "version" in e for e in entries):
        raise ValueError(f"{path}: expected a list of entries with version and ratios")
    return entries


def newest(entries: Sequence[Entry], name: str) -> Entry | None:
    """The last entry that has a ratio."""
    return next((e for e in reversed(entries) if name in e["ratios"]), None)


def ratios_of(results: Mapping[str, dict[str, Any]]) -> dict[str, list[float]]:
    """The watched ratios in results of benchmarks, a figure a round."""
    found = {name: WATCHED[name][1](result) for name, result in results.items()}
    return {name: [round(r, 4) for r in rounds] for name, rounds in found.items() if rounds}


def add(results: Mapping[str, dict[str, Any]], version: str, path: Path = RECORD) -> Entry:
    """Append an entry to the record, or to the entry of this version and day, and give it.

    Raises
    ------
    ValueError
        When the file is no record.
    """
    entries = read(path)
    day = time.strftime("%Y-%m-%d", time.gmtime())
    if not entries or (entries[-1]["version"], entries[-1]["day"]) != (version, day):
        entries.append({"version": version, "day": day, "ratios": {}})
    entries[-1]["ratios"] |= ratios_of(results)
    path.write_text(json.dumps(entries, indent=1) + "\n")
    entry: Entry = entries[-1]
    return entry


def falls(results: Mapping[str, dict[str, Any]], entries: Sequence[Entry]) -> dict[str, Fall]:
    """Each ratio that is on record, beside the newest entry that has it."""
    found = {}
    for name, rounds in ratios_of(results).items():
        entry = newest(entries, name)
        if entry is not None:
            found[name] = compare(entry["ratios"][name], rounds)
    return found


def render(found: Mapping[str, Fall], entries: Sequence[Entry]) -> str:
    """A line for each ratio."""
    lines = []
    for name, fall in found.items():
        entry = newest(entries, name)
        since = "" if entry is None else f"{entry['version']}, {entry['day']}"
        verdict = "FELL" if fall.fell else "holds"
        lines.append(
            f"{verdict:5}  {name:<8}{fall.before:>9.3g} ({since}) now {fall.now:.3g}: "
            f"{-100 * fall.part:+.0f} %, noise {100 * fall.noise:.0f} %; {WATCHED[name][0]}"
        )
    return "\n".join(lines) or "nothing on record to compare with"
