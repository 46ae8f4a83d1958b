"""``[keys]``: what the operator claims that every tap misses. It decides which keys are made."""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from protocol.scenario.parts import ScenarioTable
from protocol.secret.blocks import Schedule, schedule_of
from protocol.secret.bound import NONCE_BITS, Assumption, Directions, GilbertElliott

Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


MOST_APPEARANCES: Final = 16
"""Most appearances that a claim may state."""


class Bursts(ScenarioTable):
    """All four parameters of a tap's channel with two states, good and bad (Gilbert-Elliott)."""

    loss_good: Probability
    """Probability that the tap misses a copy in the good state."""
    loss_bad: Probability
    """Probability that the tap misses a copy in the bad state."""
    to_bad: Annotated[float, Field(gt=0, le=1)]
    """Probability of a change from good to bad between two copies."""
    to_good: Annotated[float, Field(gt=0, le=1)]
    """Probability of a change from bad to good between two copies."""


class Keys(ScenarioTable):
    """The claim that keys rest on.

    ``eps_E`` is the least probability, given everything that happened before, that a tap misses the
    next appearance of a copy 0 entirely. Its default is 0, which makes no key. A copy that leaves
    ``appearances`` times is missed with probability eps_E^appearances at least. ``bursts`` takes
    the place of ``eps_E`` where the tap's whole channel is known. ``assume = "independent"`` claims
    that her misses do not depend on the link's own losses.
    """

    eps_E: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Least probability that a tap misses the next appearance of a copy, whatever happened before;
    0 makes no key."""
    eps_sec: Annotated[float, Field(gt=0, le=1e-3)] = 1e-12
    """Distance from a perfect key, in total variation, that one block may have."""
    directions: Directions = "both"
    """Direction whose copies the claim is about; the other one's do not count."""
    assume: Literal["nothing", "independent"] = "nothing"
    """Whether the tap's misses are independent of the link's losses. A jammer breaks this."""
    bursts: Bursts | None = None
    """The tap's whole channel, in place of eps_E."""
    unheard_bits: Annotated[int, Field(ge=16, le=NONCE_BITS, multiple_of=16)] = NONCE_BITS
    """Bits of the nonce in a missed message that stay unheard, in whole words of 16."""
    appearances: Annotated[int, Field(ge=1, le=MOST_APPEARANCES)] = 1
    """How often a first copy leaves an end at most. Where it leaves more often no key is made."""

    @model_validator(mode="after")
    def _one_claim(self) -> Self:
        if self.bursts is not None and self.eps_E:
            raise ValueError("expected eps_E, or a table bursts that takes its place, and not both")
        return self

    @model_validator(mode="after")
    def _whole_appearances(self) -> Self:
        """Several appearances need whole messages: parts heard of each may add up to the whole."""
        for name, stated in (("bursts", self.bursts is not None), ("unheard_bits", self._partly)):
            if self.appearances > 1 and stated:
                raise ValueError(
                    f"got appearances = {self.appearances} beside {name}, expected 1: "
                    "a claim for several appearances is of whole messages, one by one"
                )
        return self

    @property
    def _partly(self) -> bool:
        return self.unheard_bits < NONCE_BITS

    def assumption(self) -> Assumption:
        """The claim, as the bound reads it."""
        bursts = None
        if self.bursts is not None:
            bursts = GilbertElliott(**self.bursts.model_dump())
        return Assumption(
            eps_E=self.eps_E if bursts is None else bursts.eps_inf,
            eps_sec=self.eps_sec,
            directions=self.directions,
            independent=self.assume == "independent",
            bursts=bursts,
            unheard_bits=self.unheard_bits,
            appearances=self.appearances,
        )

    def schedule(self) -> Schedule | None:
        """The lengths of blocks; None where the claim makes no key."""
        return schedule_of(self.assumption())

    def refusal(self) -> str | None:
        """Why there will be no key, or None."""
        if self.schedule() is not None:
            return None
        if not self.assumption().eps_E:
            return (
                "eps_E = 0: nothing is claimed that a tap misses, so no key can be promised; "
                "state keys.eps_E if you can"
            )
        return f"eps_E = {self.assumption().eps_E:g}: no block is long enough for a key"

    def shared(self) -> dict[str, object]:
        """What both ends must agree on, for their fingerprint: the claim and all that follows."""
        schedule = self.schedule()
        claim = self.model_dump(exclude_none=True)
        if schedule is None:
            return claim
        a = schedule.assumption
        lengths = sorted({schedule.length(b) for b in range(16)})
        misses = [(n, a.misses(a.copies * n)) for n in lengths]
        return {**claim, "largest": schedule.largest, "misses": misses}
