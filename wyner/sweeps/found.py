"""What a sweep found, point by point."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.statistics import STATED
from protocol.text import aligned
from wyner.sweeps.results import Summary


@dataclass(frozen=True)
class FoundBySweep:
    """The points of a sweep, each with all its rows added up.

    Parameters
    ----------
    name : str
    output, rates : Path
        The rows, and the table of rates with their intervals.
    grid : tuple of str
        The fields that the sweep varies.
    rows, new : int
        Rows in the file, and how many of them are new.
    points : tuple of Summary
    """

    name: str
    output: Path
    rates: Path
    grid: tuple[str, ...]
    rows: int
    new: int
    points: Sequence[Summary]

    def to_json(self) -> dict[str, Any]:
        """An object for each point."""
        points = []
        for s in self.points:
            rate = s.rate.as_json()
            why = {"no_interval": rate["no_interval"]} if "no_interval" in rate else {}
            points.append(
                {
                    **{name: s.first[name] for name in ("task", "scenario", "variant")},
                    "fields": {field: json.loads(s.first[field]) for field in self.grid},
                    "runs": s.runs,
                    "bits_per_second": rate["value"],
                    "interval_95": [rate["low"], rate["high"]],
                    **why,
                    "secret": {
                        "bits_per_second_at_most": s.secret,
                        "no_interval": {"bits_per_second_at_most": STATED},
                    },
                    "costs": {name: cost.as_json() for name, cost in s.costs.items()},
                    "shares": {name: share.as_json() for name, share in s.shares.items()},
                    **s.counts,
                }
            )
        output = str(self.output)
        return {"sweep": self.name, "output": output, "new_rows": self.new, "points": points}

    def __str__(self) -> str:
        """A table with a row for each point, and where the files are."""
        head = ["scenario", "variant", *self.grid, "runs", "bit/s", "secret at most"]
        head += ["x'x", "u'u", "mistaken"]
        head += [f"{name} keys, messages" for name in (self.points[0].taps if self.points else ())]
        table = [head, *map(self._row, self.points)]
        columns = [column for column in zip(*table, strict=True) if any(column[1:])]
        return "\n".join(
            [
                *aligned(zip(*columns, strict=True)),
                f"{self.rows} rows in {self.output}, {self.new} of them new",
                f"rates and intervals, a row a point, in {self.rates}; "
                f"`wyner sweep {self.rates} --plot` draws them",
            ]
        )

    def _row(self, s: Summary) -> list[str]:
        return [
            str(s.first["scenario"]),
            str(s.first["variant"]),
            *(str(s.first[name]) for name in self.grid),
            str(s.runs),
            s.rate.text(".4g"),
            "no eavesdropper" if s.secret is None else f"{s.secret:.2g}",
            *(f"{cost.value:.3g}" for cost in s.costs.values()),
            str(s.counts["mistaken"]),
            *(_share(s, name) for name in s.taps),
        ]


def _share(s: Summary, name: str) -> str:
    counts = s.taps[name]
    keys = s.shares[f"{name} keys known"].scaled(100.0)
    return f"{keys.text('.1f', ' %')}, {counts['read']} of {counts['delivered']}"
