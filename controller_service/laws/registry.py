"""The control laws by name, and what makes one of a design.

A law is a class and a row here, or a class in a file of the user's, ``path/to/file.py:Name``. The
rows name the classes and do not load them: who only reads a scenario needs no numerics.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, cast

from protocol.plugins import load, names_a_file
from protocol.scenario import Scenario
from protocol.scenario.kinds import law_table

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design, Progress


class LawFactory(Protocol):
    """A law's class: the design that it needs, and the law on that design."""

    def __call__(self, scenario: Scenario, design: "Design") -> "CandidateLaw": ...  # noqa: D102

    def synthesise(self, scenario: Scenario, progress: "Progress | None" = None) -> "Design": ...  # noqa: D102


LAWS: Final = {
    "paper": "controller_service.laws.paper:PaperLaw",
    "sustained": "controller_service.laws.sustained:SustainedLaw",
    "packed": "controller_service.laws.packed:PackedLaw",
}
"""Where the shipped laws are; the tables that they read stand in `protocol.scenario.LAWS`."""


def law_named(name: str) -> LawFactory:
    """The law of that name.

    Raises
    ------
    UnknownError
        When there is none.
    """
    law_table(name)  # which knows what a law is
    return cast("LawFactory", load(name, LAWS))


def make_law(scenario: Scenario, design: "Design") -> "CandidateLaw":
    """The law ``control.law`` of the scenario, on its design.

    Raises
    ------
    ProgramError
        When its programs have no unique answers, or a user's law answers what is no candidates.
    """
    name = scenario.control.law
    law = law_named(name)(scenario, design)
    if not names_a_file(name):
        return law
    from controller_service.laws.own import OwnLaw, try_at_origin

    own = OwnLaw(name, law, scenario)
    try_at_origin(own, scenario)
    return own


def synthesise(scenario: Scenario, progress: "Progress | None" = None) -> "Design":
    """Compute the design that the scenario's law needs.

    Raises
    ------
    SynthesisError
        With one line, when there is none.
    """
    from controller_service.sets.terminal import SynthesisError
    from protocol.convex import SetError

    try:
        return law_named(scenario.control.law).synthesise(scenario, progress)
    except SetError as error:
        raise SynthesisError(f"control.law: {scenario.control.law}: {error}") from None


def cached_design(
    scenario: Scenario, progress: "Progress | None" = None, cache_dir: Path | None = None
) -> "Design":
    """Read the scenario's design from the cache, or compute and store it.

    The default folder is ``$XDG_CACHE_HOME/wyner/designs``, else ``~/.cache/wyner/designs``.

    Raises
    ------
    SynthesisError
        As :func:`synthesise`.
    """
    from controller_service.sets.design_cache import load, store

    fingerprint = scenario.design_fingerprint()
    found = load(fingerprint, cache_dir)
    if found is not None:
        return found
    design = synthesise(scenario, progress)
    store(design, fingerprint, cache_dir)
    return design
