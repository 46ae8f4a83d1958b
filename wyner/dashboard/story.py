"""The moments of a run at which ``wyner up --story`` pauses, each with a caption.

A pure function of the state: the moments are found in the order in which they can be understood,
and each is told once. The pictures are of what was really published.
"""

from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Final

from wyner.dashboard.model import State
from wyner.dashboard.score import score


@dataclass(frozen=True, slots=True)
class Moment:
    """A title and its lines, for a screen of 80 columns, and the step that the picture is of.

    Without a step the picture is the newest.
    """

    title: str
    lines: tuple[str, ...]
    step: int | None = None

    @property
    def caption(self) -> tuple[str, ...]:
        """The title first."""
        return (self.title, *self.lines)


Tell = Callable[[State], Moment | None]


def _agreed(state: State) -> list[int]:
    """The pictured steps in which a key was agreed."""
    return [k for k, shown in state.pictures.items() if shown.pictured_symbol >= 0]


def _first_agreement(state: State) -> Moment | None:
    agreed = _agreed(state)
    if not agreed:
        return None
    first = min(agreed)
    key = state.pictures[first].pictured_symbol
    return Moment(
        f"The first agreement seen, at step {first}",
        (
            f"Two inputs were offered; the plant tossed a coin and applied input {key}.",
            f"The state came into D_c around prediction {key} and around no other, so both",
            f"ends know the coin: key symbol {key}. Every D_e holds it: she cannot tell?",
        ),
        first,
    )


def _first_message_symbol(state: State) -> Moment | None:
    agreed = _agreed(state)
    # The one after an agreement that was seen, so that the two captions follow each other.
    its = (k for k, truth in state.truths.items() if truth.role == "message" and agreed)
    steps = [k for k in its if k > min(agreed)]
    if not steps:
        return None
    return Moment(
        f"The first ciphertext under a key after it, at step {min(steps)}",
        (
            "In the step after an agreement the offer carries message bit plus key bit.",
            "Everyone reads that sum; whoever has the key subtracts it. In other steps a",
            "random bit stands in its place, so that nobody sees which ones count.",
        ),
        min(agreed),
    )


def _nearest_centre(state: State) -> Moment | None:
    tap = state.taps.get("nearest-centre")
    if tap is None:
        return None
    its = score(state, tap)
    if its.scored < 8:
        return None
    return Moment(
        f"What the nearest prediction tells: {its.right} of {its.scored} keys right",
        (
            "She does not know D_c. But whenever a key is agreed, the state lies nearer",
            "to the true prediction than to any other: the rule itself says so. Possible",
            "is not likely. She lacks one thing: in which steps was a key agreed?",
        ),
    )


def _list(state: State) -> Moment | None:
    tap = state.taps.get("list-decoder")
    if tap is None or tap.status.candidates_left < 2 or not tap.status.message.strip("·"):
        return None
    return Moment(
        f"Her list: {tap.status.candidates_left} ways to read the same steps",
        (
            "Which steps agreed a key depends on a threshold that she does not know.",
            "Only so many of them make a difference. She decodes under each, and keeps",
            "what reads like a message.",
        ),
    )


def _she_has_it(state: State) -> Moment | None:
    plant = state.plant
    for name, tap in state.taps.items():
        if tap.exact and tap.status.solved_k >= 0:
            both = plant is not None and plant.last_message == tap.status.message
            k = plant.message_k if plant is not None and both else -1
            return Moment(
                f"She has the message, at step {tap.status.solved_k}",
                (
                    f"{name} is sure of it, and it is the true one: its check fits.",
                    *([f"The plant has had it since step {k}."] if k >= 0 else []),
                    "No key was broken, nothing was stolen: it follows from what all can read.",
                ),
            )
    return None


MOMENTS: Final[tuple[Tell, ...]] = (
    _first_agreement,
    _first_message_symbol,
    _nearest_centre,
    _list,
    _she_has_it,
)


def next_moment(state: State, told: Set[int]) -> tuple[int, Moment] | None:
    """The first moment not ``told`` yet that the state shows by now, and its place.

    None before the plant's model was heard: a caption stands beside a picture.
    """
    if state.model is None:
        return None
    for place, tell in enumerate(MOMENTS):
        if place not in told and (moment := tell(state)) is not None:
            return place, moment
    return None
