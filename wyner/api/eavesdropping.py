"""Eavesdroppers who hear simulated runs."""

from collections.abc import Sequence
from dataclasses import dataclass

from tap_service.eavesdroppers import Eavesdropper
from wyner.api.simulation import Simulated
from wyner.scoring.statistics import Interval, wilson
from wyner.simulate.engine.taps import Heard, listen


@dataclass(frozen=True, slots=True)
class TapScore:
    """What one eavesdropper got of some runs.

    Parameters
    ----------
    name : str
    keys : Interval
        Share of the agreed key symbols that she guessed right at once, with the 95 % Wilson
        interval; a blind guess has 1/M. (0.5, 0, 1) where none was agreed and M = 2.
    agreements, right : int
    delivered, read : int
        Whole messages that the plant recovered, and how many of them she had in the end.
    """

    name: str
    keys: Interval
    agreements: int
    right: int
    delivered: int
    read: int


def eavesdrop(
    runs: Simulated,
    eavesdroppers: Sequence[str | type[Eavesdropper]] = ("set-membership", "nearest-centre"),
) -> list[TapScore]:
    """Let eavesdroppers hear every run's public messages, nothing lost, and score them.

    Parameters
    ----------
    runs : Simulated
    eavesdroppers : sequence of str or class
        Names of :data:`LADDER`, ``file.py:Name``, or classes that extend :class:`Eavesdropper`.

    Raises
    ------
    KnowledgeError
        When there is no such eavesdropper.
    """
    heard = [listen(runs.record, runs.link, eavesdroppers, r) for r in range(runs.count)]
    size = runs.system.scenario.secrecy.candidates
    return [
        _score(e if isinstance(e, str) else e.name, [of_run[i] for of_run in heard], size)
        for i, e in enumerate(eavesdroppers)
    ]


def _score(name: str, heard: Sequence[Heard], size: int) -> TapScore:
    agreements, right = sum(h.agreements for h in heard), sum(h.right for h in heard)
    keys = wilson(right, agreements) if agreements else Interval(1.0 / size, 0.0, 1.0)
    delivered, read = sum(h.delivered for h in heard), sum(h.read for h in heard)
    return TapScore(name, keys, agreements, right, delivered, read)
