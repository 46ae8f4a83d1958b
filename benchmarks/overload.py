"""Too many loops: whether they miss evenly, and for how long after the load has gone.

A fleet runs at a pace that asks for more than the machine can do. Its file is then cut to a tenth:
the others leave, and what stays fits. Five seconds later nothing may be missed any more.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from benchmarks.fleet import (
    PATIENCE_S,
    hosts,
    statuses_in,
    wait_until_all_run,
    write_fleet,
)
from runtime.errors import Failure

SETTLE_S: Final = 3.0
RECOVER_S: Final = 5.0
"""From the end of the load to the first step that may not be missed."""

CALM_S: Final = 10.0
"""How long is then looked for missed steps."""


def measure(
    *,
    loops: int = 200,
    seconds: float = 15.0,
    pace: str = "x4",
    recover_s: float = RECOVER_S,
    calm_s: float = CALM_S,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Overload a fleet, take nine tenths of it away, and count.

    Parameters
    ----------
    loops : int
        Of which a tenth stays.
    seconds : float
        Length of the overload's window.
    pace : str
        As for ``wyner plant``.
    recover_s, calm_s : float
        From the end of the load to the calm window, and the window's length.
    progress : callable, optional
        Told in a line what is under way.

    Returns
    -------
    dict
        ``asked`` (steps that the window's ticks asked for), ``made`` and ``missed``, the loops'
        ``least``, ``median`` and ``most`` steps made, ``stay`` (loops), ``leaving_s`` (until the
        others had left), ``missed_after`` of ``steps_after`` (in the calm window).

    Raises
    ------
    Failure
        When a host fails, or not every loop comes to run, or one does not leave.
    """
    say = progress or (lambda _line: None)
    stay = max(loops // 10, 1)
    with tempfile.TemporaryDirectory(prefix="wyner-overload-") as name:
        folder = Path(name)
        with hosts(write_fleet(folder, loops, "sustained"), pace) as services:
            wait_until_all_run(folder, loops, services)
            say(f"{loops} loops run, too fast")
            time.sleep(SETTLE_S)
            before, began = _counts(folder), time.monotonic()
            time.sleep(seconds)
            after, taken = _counts(folder), time.monotonic() - began
            write_fleet(folder, stay, "sustained")
            ended = time.monotonic()
            while _phases(folder).count("stopped") < loops - stay:
                if time.monotonic() > ended + PATIENCE_S:
                    raise Failure(f"not every loop has left after {PATIENCE_S:g} s")
                time.sleep(0.05)
            leaving_s = time.monotonic() - ended
            say(f"{loops - stay} loops have left")
            time.sleep(recover_s)
            calm = _counts(folder)
            time.sleep(calm_s)
            last = _counts(folder)
    made = sorted(after[loop][0] - before[loop][0] for loop in before)
    missed = sum(after[loop][1] - before[loop][1] for loop in before)
    return {
        "loops": loops,
        "pace": pace,
        "seconds": taken,
        "asked": sum(made) + missed,
        "made": sum(made),
        "missed": missed,
        "least": made[0],
        "median": made[len(made) // 2],
        "most": made[-1],
        "stay": stay,
        "recover_s": recover_s,
        "leaving_s": leaving_s,
        "missed_after": sum(last[loop][1] - calm[loop][1] for loop in calm),
        "steps_after": sum(sum(last[loop]) - sum(calm[loop]) for loop in calm),
    }


def _counts(folder: Path) -> dict[str, tuple[int, int]]:
    """Steps made and missed, by loop."""
    return {s["session"]: (s["transitions"], s["missed"]) for s in statuses_in(folder)}


def _phases(folder: Path) -> list[str]:
    return [s["phase"] for s in statuses_in(folder)]


def render(result: dict[str, Any]) -> str:
    """The result of :func:`measure` for people."""
    asked, made = result["asked"], result["made"]
    calm = result["missed_after"]
    return "\n".join(
        [
            f"{result['loops']} loops at {result['pace']} for {result['seconds']:.0f} s: "
            f"{made} of {asked} steps made ({asked / max(made, 1):.1f} times too much asked)",
            f"steps made by a loop   least {result['least']}, median {result['median']}, "
            f"most {result['most']}",
            f"{result['loops'] - result['stay']} loops left within {result['leaving_s']:.1f} s; "
            f"from {result['recover_s']:g} s later {result['stay']} loops missed {calm} of "
            f"{result['steps_after']}   (target 0: {'reached' if calm == 0 else 'MISSED'})",
        ]
    )
