"""The tables of attacks in docs/findings.md."""

from collections.abc import Sequence
from typing import Final

from protocol.statistics import wilson
from studies.registry import Lines, Row, table

SHOWN: Final = (1, 2, 3, 5)
GROUPS: Final = ("limit", "key", "size", "eye", "bus")
"""Those of one table, in this order; `matrix` and `honest` have one each."""

KEYS: Final = {
    "nobody": "-",
    "secret": "secret",
    "false claim": "false claim, Eve hears all",
    "nearest-centre": "the paper's, read by `nearest-centre`",
}


def unseen(row: Row) -> list[int]:
    """Runs without an alarm after 0, 1, 2, ... attacked steps."""
    return [int(n) for n in row["unseen"].split()]


def share(count: int, runs: int) -> str:
    """A share with its interval, as short as it can be said."""
    found = wilson(count, runs)
    if count == runs:
        return f"1 (above {found.low:.4f})"
    if count == 0:
        return f"0 (below {found.high:.4f})"
    return f"{found.value:.3f} [{found.low:.3f}, {found.high:.3f}]"


@table("attacks", "findings", "attacks")
def main_table(rows: Sequence[Row]) -> Lines:
    """Who attacks, what stands against her, who has the key, and what became of it."""
    lines: list[tuple[str, ...]] = [
        (
            "attack",
            "defence, M",
            "key",
            *(f"unseen after {n}" for n in SHOWN),
            "at the end",
            "plant away: mean, largest",
        )
    ]
    for group in GROUPS:
        for row in (r for r in rows if r["group"] == group):
            runs, left = int(row["runs"]), unseen(row)
            lines.append(
                (
                    row["attack"],
                    f"{row['defence']}, {row['M']}",
                    KEYS[row["key"]],
                    *(share(left[n], runs) for n in SHOWN),
                    f"{share(left[-1], runs)} at {row['steps']}",
                    f"{float(row['away']):.2f}, {float(row['away_largest']):.2f}",
                )
            )
    return lines


@table("matrix", "findings", "attacks")
def matrix_table(rows: Sequence[Row]) -> Lines:
    """Shares unseen after ten steps: attacks down, defences across, key had and not had."""
    mine = [r for r in rows if r["group"] == "matrix"]
    heads = list(dict.fromkeys((r["defence"], r["key"]) for r in mine))
    has = {"nobody": "", "secret": ", key secret", "false claim": ", Eve has the key"}
    lines: list[tuple[str, ...]] = [("attack", *(f"{d}{has[k]}" for d, k in heads))]
    for attack in dict.fromkeys(r["attack"] for r in mine):
        cells = []
        for head in heads:
            (row,) = (r for r in mine if r["attack"] == attack and (r["defence"], r["key"]) == head)
            cells.append(share(unseen(row)[10], int(row["runs"])))
        lines.append((attack, *cells))
    return lines


@table("honest", "findings", "attacks")
def honest_table(rows: Sequence[Row]) -> Lines:
    """False alarms by disturbance."""
    mine = [r for r in rows if r["group"] == "honest"]
    lines: list[tuple[str, ...]] = [("disturbance", "honest steps", "alarms")]
    lines += [(r["key"], f"{int(r['honest_steps']):,}", r["false_alarms"]) for r in mine]
    total = sum(int(r["honest_steps"]) for r in mine)
    lines.append(("all", f"{total:,}", str(sum(int(r["false_alarms"]) for r in mine))))
    return lines
