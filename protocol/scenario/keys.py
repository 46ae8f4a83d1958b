"""``[keys]``: what the operator claims that every tap misses. It decides which keys are made."""

from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from protocol.scenario.parts import ScenarioTable
from protocol.secret.blocks import Schedule, schedule_of
from protocol.secret.bound import NONCE_BITS, Assumption, Directions

MOST_APPEARANCES: Final = 16
"""Most appearances that a claim may state."""


class Keys(ScenarioTable):
    """The claim that keys rest on.

    ``eps_E`` is the least probability, given everything that happened before, that a tap misses the
    next appearance of a copy 0 entirely; it has no default above 0, and 0 makes no key. A copy that
    leaves ``appearances`` times is missed with that power of it.
    """

    eps_E: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Least probability that a tap misses the next appearance of a copy, whatever happened before;
    0 makes no key."""
    eps_sec: Annotated[float, Field(gt=0, le=1e-3)] = 1e-12
    """Distance from a perfect key, in total variation, that one block may have."""
    directions: Directions = "both"
    """Direction whose copies the claim is about; the other one's do not count."""
    unheard_bits: Annotated[int, Field(ge=16, le=NONCE_BITS, multiple_of=16)] = NONCE_BITS
    """Bits of the nonce in a missed message that stay unheard, in whole words of 16."""
    appearances: Annotated[int, Field(ge=1, le=MOST_APPEARANCES)] = 1
    """How often a first copy leaves an end at most. Where it leaves more often no key is made."""

    @model_validator(mode="after")
    def _whole_appearances(self) -> Self:
        """Several appearances need whole messages: parts heard of each may add up to the whole."""
        if self.appearances > 1 and self.unheard_bits < NONCE_BITS:
            raise ValueError(
                f"got appearances = {self.appearances} beside unheard_bits, expected 1: "
                "a claim for several appearances is of whole messages, one by one"
            )
        return self

    def assumption(self) -> Assumption:
        """The claim, as the bound reads it."""
        return Assumption(**self.model_dump())

    def schedule(self) -> Schedule | None:
        """The lengths of blocks; None where the claim makes no key."""
        return schedule_of(self.assumption())

    def refusal(self) -> str | None:
        """Why there will be no key, or None."""
        if self.schedule() is not None:
            return None
        if not self.assumption().eps_E:
            return (
                "eps_E = 0: nothing is claimed that a tap misses, so no key can be promised (state "
                "keys.eps_E if you can)"
            )
        return f"eps_E = {self.assumption().eps_E:g}: no block is long enough for a key"
