"""What the shipped laws read of ``[control]``, and what of it the tap is granted."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Final

from pydantic import Field

from protocol.knowledge import Policy
from protocol.scenario.control import Control, Cost
from protocol.scenario.parts import ScenarioTable
from protocol.scenario.secrecy import Secrecy

CERTAIN: Final = 2.0
"""Spacing, in half-lengths of D_c along the input, from which an agreement is certain."""


class PaperControl(Control):
    """``[control]`` of the law ``paper``."""

    def policy(self, n: int, m: int) -> Policy:
        """The costs and K; inside T_0 the candidates are one."""
        return super().policy(n, m).model_copy(update={"together": True})


class AlphabetTable(ScenarioTable):
    """``[control.alphabet]``: how far apart the law ``packed`` keeps its candidates.

    Parameters
    ----------
    spacing : float
        In half-lengths of D_c along the inputs. From 2 every transition agrees, whatever d in D_c;
        below 2 the alphabet bets on the disturbance.
    """

    spacing: Annotated[float, Field(gt=0, le=1000)] = 2.0
    """Distance of neighbouring candidates, in half-lengths of D_c along the inputs."""


class PackedControl(Control):
    """``[control]`` of the law ``packed``: one cost, whatever the number of candidates.

    Neither gain nor regulator is needed: where none keeps a set, T_0 is the largest set that any
    control keeps.
    """

    needs_gain: ClassVar[bool] = False
    knows_alpha: ClassVar[bool] = True
    alphabet: AlphabetTable = AlphabetTable()
    """How far apart the candidates are kept."""
    costs: tuple[Cost, ...] = (Cost(next_state=1.0),)
    """One cost, whatever M."""

    def count_problems(self, candidates: int) -> Iterator[str]:  # noqa: ARG002
        """Whether there is one cost."""
        if len(self.costs) != 1:
            yield f"control.costs: got {len(self.costs)} costs, expected one for law packed"

    def why_unseen(self) -> Iterator[str]:
        """Whether candidates are so close that a spoofed sensor may stay unseen."""
        spacing = self.alphabet.spacing
        if spacing < CERTAIN:
            yield (
                f"control.alphabet.spacing = {spacing:g} does not tell candidates apart in every "
                f"step, expected {CERTAIN:g} or more"
            )

    def policy(self, n: int, m: int) -> Policy:
        """The cost, how far apart the candidates are, and whether every transition agrees."""
        spacing = self.alphabet.spacing
        update = {"certain": spacing >= CERTAIN, "spacing": spacing}
        return super().policy(n, m).model_copy(update=update)

    def design_key(self, secrecy: Secrecy) -> dict[str, Any]:
        """The alphabet depends on M and D_e too."""
        key = super().design_key(secrecy)
        wider = secrecy.disturbance
        shape = {} if wider is None else {"D_e": wider.model_dump(exclude_none=True)}
        return {**key, **shape, "candidates": secrecy.candidates, "alpha": secrecy.alpha}
