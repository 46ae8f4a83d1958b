"""Eavesdroppers who hear simulated runs."""

from collections.abc import Sequence
from dataclasses import dataclass

from protocol.statistics import NOTHING, Interval, share_over_runs
from tap_service.eavesdroppers import Eavesdropper, sound
from wyner.api.simulation import Simulated
from wyner.simulate.engine.taps import TapResult, listen


@dataclass(frozen=True, slots=True)
class TapScore:
    """What one eavesdropper got of some runs.

    Parameters
    ----------
    name : str
    keys : Interval
        Share of the agreed key symbols that Eve knew at once, with its 95 % interval over runs; a
        blind guess has 1/M. Symbols count as named, unless one relabelling for a whole run is shown
        to be better. Fewer than five runs have no limits (NaN). Where none was agreed, or where Eve
        does not guess, there is no share.
    agreements, right, known : int
        Key symbols that were agreed, that Eve named right at once, and that Eve knew.
    delivered, read : int
        Whole messages that the plant recovered, and how many of them Eve had in the end.
    """

    name: str
    keys: Interval
    agreements: int
    right: int
    known: int
    delivered: int
    read: int


def eavesdrop(
    runs: Simulated,
    eavesdroppers: str | type[Eavesdropper] | Sequence[str | type[Eavesdropper]] = (
        "set-membership",
        "nearest-centre",
    ),
) -> list[TapScore]:
    """Let eavesdroppers hear every run's public messages, nothing lost, and score them.

    Parameters
    ----------
    runs : Simulated
    eavesdroppers : str or class, or sequence of them
        Names of :data:`LADDER`, ``file.py:Name``, or classes that extend :class:`Eavesdropper`.

    Raises
    ------
    KnowledgeError
        When there is no such eavesdropper.
    EavesdropperError
        When one raises; its text has name and step.
    """
    if isinstance(eavesdroppers, str | type):
        eavesdroppers = [eavesdroppers]
    heard = [listen(runs.record, runs.link, eavesdroppers, r) for r in range(runs.count)]
    kinds = [sound(e) for e in eavesdroppers]
    return [_score(kind, [of_run[i] for of_run in heard]) for i, kind in enumerate(kinds)]


def _score(kind: type[Eavesdropper], heard: Sequence[TapResult]) -> TapScore:
    name = kind.name
    agreements, right = sum(h.agreements for h in heard), sum(h.right for h in heard)
    known = sum(h.known for h in heard)
    keys = NOTHING
    if kind.guesses:
        keys = share_over_runs([(h.known, h.agreements) for h in heard])
    delivered, read = sum(h.delivered for h in heard), sum(h.read for h in heard)
    return TapScore(name, keys, agreements, right, known, delivered, read)
