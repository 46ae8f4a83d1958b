"""The moments of a run at which ``wyner up --story`` pauses, each with a caption.

A list of predicates with their texts: a predicate of the state gives what its text names, or None.
The moments are found in the order in which they can be understood, and each is told once. The
pictures are of what was really published.
"""

from collections.abc import Callable, Set
from typing import Any, Final, NamedTuple

from wyner.dashboard.model import State
from wyner.dashboard.score import score

ENOUGH: Final = 8
"""Keys of which it is said how many she names right."""

Facts = dict[str, Any]
"""What a text names; ``step`` is the one that the picture is of, where there is one."""


class Moment(NamedTuple):
    """A title and its lines, for a screen of 80 columns, and the step that the picture is of.

    Without a step the picture is the newest.
    """

    caption: tuple[str, ...]
    step: int | None = None


def _agreed(state: State) -> list[int]:
    """The pictured steps in which a key was agreed."""
    return [k for k, shown in state.pictures.items() if shown.pictured_symbol >= 0]


def _first_agreement(state: State) -> Facts | None:
    first = min(_agreed(state), default=None)
    if first is None:
        return None
    return {"step": first, "key": state.pictures[first].pictured_symbol}


def _first_message_symbol(state: State) -> Facts | None:
    """After an agreement that was seen, so that the two captions follow each other."""
    first = min(_agreed(state), default=None)
    if first is None:
        return None
    steps = (k for k, truth in state.truths.items() if truth.role == "message" and k > first)
    carried = min(steps, default=None)
    return None if carried is None else {"step": first, "carried": carried}


def _nearest_centre(state: State) -> Facts | None:
    tap = state.taps.get("nearest-centre")
    its = None if tap is None else score(state, tap)
    if its is None or its.scored < ENOUGH:
        return None
    return {"right": its.right, "scored": its.scored}


def _list(state: State) -> Facts | None:
    tap = state.taps.get("list-decoder")
    if tap is None or tap.status.candidates_left < 2 or not tap.status.message.strip("·"):
        return None
    return {"left": tap.status.candidates_left}


def _she_has_it(state: State) -> Facts | None:
    plant = state.plant
    for name, tap in state.taps.items():
        if tap.exact and tap.status.solved_k >= 0:
            both = plant is not None and plant.last_message == tap.status.message
            k = plant.message_k if plant is not None and both else -1
            had = f"The plant has had it since step {k}." if k >= 0 else ""
            return {"name": name, "solved": tap.status.solved_k, "had": had}
    return None


MOMENTS: Final[tuple[tuple[Callable[[State], Facts | None], str], ...]] = (
    (
        _first_agreement,
        """The first agreement seen, at step {step}
Two inputs were offered; the plant tossed a coin and applied input {key}.
The state came into D_c around prediction {key} and around no other, so both
ends know the coin: key symbol {key}. Every D_e holds it: she cannot tell?""",
    ),
    (
        _first_message_symbol,
        """The first ciphertext under a key after it, at step {carried}
In the step after an agreement the offer carries message bit plus key bit.
Everyone reads that sum; whoever has the key subtracts it. In other steps a
random bit stands in its place, so that nobody sees which ones count.""",
    ),
    (
        _nearest_centre,
        """What the nearest prediction tells: {right} of {scored} keys right
She does not know D_c. But whenever a key is agreed, the state lies nearer
to the true prediction than to any other: the rule itself says so. Possible
is not likely. She lacks one thing: in which steps was a key agreed?""",
    ),
    (
        _list,
        """Her list: {left} ways to read the same steps
Which steps agreed a key depends on a threshold that she does not know.
Only so many of them make a difference. She decodes under each, and keeps
what reads like a message.""",
    ),
    (
        _she_has_it,
        """She has the message, at step {solved}
{name} is sure of it, and it is the true one: its check fits.
{had}
No key was broken, nothing was stolen: it follows from what all can read.""",
    ),
)


def next_moment(state: State, told: Set[int]) -> tuple[int, Moment] | None:
    """The first moment not ``told`` yet that the state shows by now, and its place.

    None before the plant's model was heard: a caption stands beside a picture.
    """
    if state.model is None:
        return None
    for place, (predicate, text) in enumerate(MOMENTS):
        if place not in told and (facts := predicate(state)) is not None:
            lines = text.format(**facts).split("\n")
            return place, Moment(tuple(filter(None, lines)), facts.get("step"))
    return None
