"""The control laws by name: the table that a law reads, and what makes it of a design.

A law is a class and a row here, or a class in a file of the user's, ``path/to/file.py:Name``. The
rows name the classes and do not load them: who only reads a scenario needs no numerics.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from controller_service.laws.tables import PackedControl, PaperControl
from protocol.registry import OwnClass, Registry, UnknownError, names_a_file
from protocol.scenario import LAWS, Control, Scenario

if TYPE_CHECKING:
    from controller_service.laws.base import CandidateLaw
    from controller_service.sets.design import Design, Progress


class LawFactory(Protocol):
    """A law's class: the design that it needs, and the law on that design."""

    def __call__(self, scenario: Scenario, design: "Design") -> "CandidateLaw": ...  # noqa: D102

    def synthesise(self, scenario: Scenario, progress: "Progress | None" = None) -> "Design": ...  # noqa: D102


_LAWS: Registry[LawFactory | str] = Registry("law")


def _own_law(name: str, own: OwnClass) -> LawFactory:
    """The law in a file of the user's."""
    found = own.found
    if not (isinstance(found, type) and callable(getattr(found, "synthesise", None))):
        raise UnknownError(
            f"got {name!r}, expected a class {own.name} that extends "
            "controller_service.laws.base.ProgramLaw, or has its methods"
        )
    return cast("LawFactory", found)


def _own_table(name: str, own: OwnClass) -> type[Control]:
    """The table that it reads: its class attribute ``table``, or that of every law."""
    table = getattr(_own_law(name, own), "table", Control)
    if not (isinstance(table, type) and issubclass(table, Control)):
        raise UnknownError(
            f"{name}: expected its table to be a class that extends protocol.scenario.Control, "
            f"got {table!r}"
        )
    return table


_LAWS.take_own(_own_law)
LAWS.take_own(_own_table)


def register(name: str, law: LawFactory | str, table: type[Control] = Control) -> None:
    """Make ``control.law = name`` mean ``law``.

    Parameters
    ----------
    name : str
    law : LawFactory or str
        The class, or where it is: ``module:Class``, loaded when it is needed.
    table : type, optional
        The table ``[control]`` that it reads, and what of it the tap is granted.
    """
    _LAWS.register(name, law)
    LAWS.register(name, table)


@contextmanager
def registered(name: str, law: LawFactory, table: type[Control] = Control) -> Iterator[None]:
    """Within the block, the law is registered."""
    with _LAWS.registered(name, law), LAWS.registered(name, table):
        yield


register("paper", "controller_service.laws.paper:PaperLaw", PaperControl)
register("sustained", "controller_service.laws.sustained:SustainedLaw")
register("packed", "controller_service.laws.packed:PackedLaw", PackedControl)


def law_named(name: str) -> LawFactory:
    """The law of that name.

    Raises
    ------
    UnknownError
        When there is none.
    """
    found = _LAWS[name]
    if isinstance(found, str):
        module, _, attribute = found.partition(":")
        law: LawFactory = getattr(import_module(module), attribute)
        return law
    return found


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
