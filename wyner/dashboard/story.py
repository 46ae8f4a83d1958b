"""The moments of a run at which ``wyner up --story`` pauses, each with a caption.

A list of predicates with their texts: a predicate of the state gives what its text names, or None.
The moments are found in the order in which they can be understood, and each is told once.
"""

from collections.abc import Callable, Set
from typing import Any, Final

from wyner.dashboard.model import LoopState
from wyner.dashboard.score import score

ENOUGH: Final = 8
"""Keys after which the share that Eve names right is told."""

Facts = dict[str, Any]
"""What a text names."""

Caption = tuple[str, ...]
"""A title and its lines, for a screen of 80 columns."""


def _agreement(state: LoopState) -> Facts | None:
    shown = state.pictured
    if shown is None or shown.symbol < 0:
        return None
    return {"step": shown.k, "key": shown.symbol}


def _message_symbol(state: LoopState) -> Facts | None:
    """The newest step that carried a message symbol, while an agreement is pictured."""
    if _agreement(state) is None:
        return None
    carried = max((k for k, t in state.truths.items() if t.role == "message"), default=None)
    return None if carried is None else {"carried": carried}


def _nearest_centre(state: LoopState) -> Facts | None:
    tap = state.taps.get("nearest-centre")
    its = None if tap is None else score(state, tap)
    if its is None or its.of < ENOUGH:
        return None
    return {"right": its.right, "scored": its.of}


def _list(state: LoopState) -> Facts | None:
    tap = state.taps.get("list-decoder")
    belief = None if tap is None else tap.status.belief
    if belief is None or belief.candidates_left < 2 or not belief.message.strip("·"):
        return None
    return {"left": belief.candidates_left}


def _whole(state: LoopState) -> Facts | None:
    plant = state.plant
    for name, tap in state.taps.items():
        belief = tap.status.belief
        if tap.exact and belief.solved_k >= 0:
            both = plant is not None and plant.secrets.last_message == belief.message
            k = plant.frame.message_k if plant is not None and both else -1
            had = f"The plant has had it since step {k}." if k >= 0 else ""
            return {"name": name, "solved": belief.solved_k, "had": had}
    return None


MOMENTS: Final[tuple[tuple[Callable[[LoopState], Facts | None], str], ...]] = (
    (
        _agreement,
        """A key is agreed, at step {step}
Several inputs were offered; the plant tossed a coin and applied input {key}.
The state came into D_c around prediction {key} and around no other, so both
ends know the coin: key symbol {key}. Every D_e holds it, too: can Eve not tell?""",
    ),
    (
        _message_symbol,
        """The message travels under such keys, as at step {carried}
In the step after an agreement the offer carries message symbol plus key.
Everyone reads that sum; the plant knows the key and subtracts it. In other
steps a random symbol stands there, so that nobody sees which steps count.""",
    ),
    (
        _nearest_centre,
        """What the nearest prediction tells: {right} of {scored} keys right
Eve does not know D_c. But whenever a key is agreed, the state lies nearer
to the true prediction than to any other: the rule itself says so. Possible
is not likely. Eve lacks one thing: in which steps was a key agreed?""",
    ),
    (
        _list,
        """Eve's list: {left} ways to read the same steps
Which steps agreed a key depends on a threshold that Eve does not know.
Only so many thresholds make a difference. Eve decodes under each, and keeps
what reads like a message.""",
    ),
    (
        _whole,
        """Eve has the message, at step {solved}
{name} is sure of it, and it is the true one: its check fits.
{had}
No key was broken, nothing was stolen: it follows from what all can read.""",
    ),
)


def next_moment(state: LoopState, told: Set[int]) -> tuple[int, Caption] | None:
    """The first moment not ``told`` yet that the state shows by now, and its place.

    None before the plant's model was received: a caption stands beside a picture.
    """
    if state.model is None:
        return None
    for place, (predicate, text) in enumerate(MOMENTS):
        if place not in told and (facts := predicate(state)) is not None:
            return place, tuple(filter(None, text.format(**facts).split("\n")))
    return None
