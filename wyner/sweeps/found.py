"""What a sweep found, point by point."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from protocol.statistics import STATED
from protocol.text import aligned
from wyner.printout import Printout
from wyner.sweeps.results import Summary


def found_by_sweep(
    name: str,
    output: Path,
    rates: Path,
    grid: Sequence[str],
    rows: int,
    new: int,
    points: Sequence[Summary],
) -> Printout:
    """An object for each point; tables of the points, their rates and their eavesdroppers.

    Parameters
    ----------
    name : str
    output, rates : Path
        The rows, and the table of rates with their intervals.
    grid : sequence of str
        The fields that the sweep varies.
    rows, new : int
        Rows in the file, and how many of them are new.
    points : sequence of Summary
        Each with all its rows added up.
    """
    numbered = [(str(number), s) for number, s in enumerate(points, start=1)]
    where = ["scenario", "variant", *grid]
    lines = _table(
        ["point", *where],
        [[number, *(str(s.first[name]) for name in where)] for number, s in numbered],
    )
    head = ["point", "runs", "bit/s", "secret", "x'x", "u'u", "mistaken"]
    lines += ["", *_table(head, [[number, *_loop(s)] for number, s in numbered])]
    lines.append("secret: bit/s that the strongest eavesdropper leaves, at most")
    taps = [[number, *row] for number, s in numbered for row in _taps(s)]
    if taps:
        head = ["point", "eavesdropper", "keys right", "messages read"]
        lines += ["", *_table(head, taps)]
    lines += [
        "",
        f"{rows} rows, {new} of them new: {output}",
        f"Rates and intervals, a row a point: {rates}",
        f"Draw them: wyner sweep {rates} --plot",
    ]
    figures = [_point(s, grid) for s in points]
    found = {"sweep": name, "output": str(output), "new_rows": new, "points": figures}
    return Printout(found, lines)


def _point(s: Summary, grid: Sequence[str]) -> dict[str, Any]:
    rate = s.rate.as_json()
    why = {"no_interval": rate["no_interval"]} if "no_interval" in rate else {}
    return {
        **{name: s.first[name] for name in ("task", "scenario", "variant")},
        "fields": {field: json.loads(s.first[field]) for field in grid},
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


def _loop(s: Summary) -> list[str]:
    """How fast a point is, and what control costs there."""
    return [
        str(s.runs),
        s.rate.text(".4g"),
        "no eavesdropper" if s.secret is None else f"{s.secret:.2g}",
        *(f"{cost.value:.3g}" for cost in s.costs.values()),
        str(s.counts["mistaken"]),
    ]


def _taps(s: Summary) -> list[list[str]]:
    """What each eavesdropper got at a point."""
    return [
        [
            name,
            s.shares[f"{name} keys known"].scaled(100.0).text(".1f", " %"),
            f"{counts['read']} of {counts['delivered']}",
        ]
        for name, counts in s.taps.items()
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The rows below their head; columns in which nothing stands are left out."""
    columns = [column for column in zip(head, *rows, strict=True) if any(column[1:])]
    return aligned(zip(*columns, strict=True))
