"""The secrecy report over runs: what the paper's rule counts, and what each eavesdropper leaves."""

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from protocol.messages.adversary import KeysHeld
from protocol.relabelling import Labels, known
from protocol.statistics import (
    CONFIDENCE,
    Interval,
    bits_left,
    share_over_runs,
    stated_left,
)
from wyner.runs.score.plain import plain
from wyner.runs.score.score import UNFINISHED, EavesdropperScore, Proportion, RunScore, Truth

BOUND: Final = (
    "The keys are a function of the public transcript and the secret part of the model, so that "
    "H(keys | transcript) <= H(model | transcript): however many keys are agreed, what stays "
    "hidden is at most what the eavesdropper does not yet know of the model. For one who knows "
    "f_c and D_e that is f widths of D_c, worth at most f log2(2N + 1) bits after N steps of two "
    "candidates: one width where D_e = alpha D_c, whatever M."
)


def over_runs(parts: Sequence[Proportion]) -> Interval:
    """The share of all runs together, with its interval over runs."""
    return share_over_runs([(p.right, p.of) for p in parts])


def percent(share: Interval) -> str:
    """As a table shows it."""
    return share.scaled(100.0).text(".1f", " %")


@dataclass(frozen=True, slots=True)
class TapReport:
    """One eavesdropper over all runs; rates are those of the runs in which she is scored.

    Parameters
    ----------
    runs : int
        Runs in which she listened.
    symbol_error_rate : Interval
        Of agreed steps that she could use, as she names the symbols, with second thoughts where she
        has any.
    symbol_error_rate_live : Interval
        The same right after each step.
    message_bit_error_rate : Interval
        Of message symbols.
    exact_message_rate : Interval
        Messages had whole and exact, of those the plant recovered.
    guessing_probability : Interval
        P_g per key symbol, never below 1/M: right up to one relabelling of the symbols a run. Its
        limits are a confidence sequence over keys, which pays for the choice of the labelling.
    relabelled : tuple of tuple of int
        The relabelling of each scored run; empty where the symbols count as she names them.
    left_bits_by_keys : Interval, optional
        Bits that she leaves of the steps that she could use, -log2 P_g for each key symbol; none of
        a run in which she had every message. An eavesdropper that is not shown to be better than
        chance leaves all of them. None where ``unscored``.
    left_bits_stated : Interval, optional
        The same by her own account, which supposes that messages are as she expects (``given``).
        None where she gives none.
    silent_bits : float
        Bits of the agreed steps that she could not use, and of runs in which she did not listen:
        what she leaves of them is not known, and counts neither for her nor as secret.
    silent_steps : int
        Those steps of the runs in which she listened.
    unused : mapping of str to int
        What the tap could not use of what it heard, by kind, in all runs.
    unscored : str
        Why nobody knows what she leaves, with the runs of which it is so.
    leads : bool
        Whether she is shown to do better than chance, at a chance of 5 % shared by all of them.
    list_size : float, optional
        Median of the candidate messages that remained.
    broken_at_k : tuple of int
        Steps at which she first was sure of a whole message, run by run; -1 never.
    size : int
        M.
    keys : tuple of KeysHeld
        What she holds of distilled keys, run by run, where she goes for them.
    """

    name: str
    runs: int
    symbol_error_rate: Interval
    symbol_error_rate_live: Interval
    message_bit_error_rate: Interval
    exact_message_rate: Interval
    agreed_steps: int
    guessing_probability: Interval
    relabelled: tuple[Labels, ...]
    left_bits_by_keys: Interval | None
    left_bits_stated: Interval | None
    given: str
    silent_bits: float
    silent_steps: int
    unused: Mapping[str, int]
    unscored: str
    leads: bool
    list_size: float | None
    broken_at_k: tuple[int, ...]
    size: int
    keys: tuple[KeysHeld, ...] = ()

    @property
    def left_bits(self) -> Interval | None:
        """Bits that she leaves of the steps that she could use: the less of both figures."""
        if self.left_bits_by_keys is None or self.left_bits_stated is None:
            return self.left_bits_by_keys
        return min(self.left_bits_by_keys, self.left_bits_stated, key=lambda left: left.high)

    @property
    def min_entropy(self) -> Interval:
        """-log2 P_g per key symbol, in bits."""
        return bits_left(1, self.size, self.guessing_probability)

    def to_json(self) -> dict[str, Any]:
        """Its figures for machines."""
        return {
            **plain(self, without=("name", "size", "leads")),
            "min_entropy_bits": plain(self.min_entropy),
            "left_bits": plain(self.left_bits),
            "list_size_log2": math.log2(self.list_size) if self.list_size else None,
        }

    @property
    def median_broken(self) -> float | None:
        """Median step at which she broke it, over the runs in which she did."""
        broken = [k for k in self.broken_at_k if k >= 0]
        return statistics.median(broken) if broken else None


@dataclass(frozen=True, slots=True)
class Report:
    """The secrecy report.

    Parameters
    ----------
    claimed_bits : float
        What the paper's rule counts over all runs, of whichever law: every agreement as log2 M
        secret bits.
    hidden_bits : float
        Bound on what stays hidden of one run's keys from one who knows f_c and D_e: the widths of
        D_c, each of which the steps cut into so many pieces.
    """

    runs: tuple[str, ...]
    transitions: int
    claimed_bits: float
    hidden_bits: float
    taps: tuple[TapReport, ...]

    @property
    def strongest(self) -> TapReport | None:
        """The eavesdropper who leaves the least, of those that are scored.

        One that could not use many steps is no strong one: what is not known of her counts here.
        """

        def left_at_most(t: TapReport) -> tuple[float, float, float]:
            assert t.left_bits is not None
            exact = 0.0 if math.isnan(t.exact_message_rate.value) else t.exact_message_rate.value
            return t.left_bits.high + t.silent_bits, -exact, t.left_bits.value

        return min(
            (t for t in self.taps if t.left_bits is not None), key=left_at_most, default=None
        )

    @property
    def unscored(self) -> dict[str, str]:
        """Who is not scored, and why."""
        return {t.name: t.unscored for t in self.taps if t.unscored}

    @property
    def exceeds(self) -> bool:
        """Whether the paper's rule is shown to count more than somebody leaves."""
        return self.claimed_bits > 0 and any(t.leads for t in self.taps)

    def to_json(self) -> dict[str, Any]:
        """The report as one object."""
        return {
            "runs": list(self.runs),
            "transitions": self.transitions,
            "claimed_bits": self.claimed_bits,
            "hidden_bits_bound": self.hidden_bits,
            "claimed_exceeds_true": self.exceeds,
            "strongest": None if self.strongest is None else self.strongest.name,
            "verdict": self.verdict(),
            "bound": BOUND,
            "taps": {t.name: t.to_json() for t in self.taps},
        }

    def verdict(self) -> str:
        """In words."""
        strongest = self.strongest
        if self.claimed_bits == 0:
            return "No key was agreed by the paper's rule: nothing counts as secret by it."
        claim = f"by the paper's rule {self.claimed_bits:.0f} bits count as secret"
        if strongest is None or strongest.left_bits is None:
            return f"{claim[0].upper()}{claim[1:]}; {self._nobody()}, so they stand untested."
        of = "them"
        if strongest.silent_bits:
            of = f"the {self.claimed_bits - strongest.silent_bits:.0f} that it could use"
        left = f"{strongest.name} leaves at most {strongest.left_bits.high:.1f} of {of}"
        if strongest.left_bits_stated is not None and strongest.left_bits_by_keys is not None:
            left += (
                f" ({strongest.left_bits_stated.high:.1f} {given(strongest.given)}, by keys alone "
                f"{strongest.left_bits_by_keys.high:.1f})"
            )
        if not self.exceeds:
            left += ", no better than chance"
        if strongest.silent_bits:
            left += f", and of {strongest.silent_bits:.0f} bits nobody knows"
        bound = (
            f"All keys together hide at most {self.hidden_bits:.1f} bits a run from one who knows"
        )
        told = "PAPER'S RULE EXCEEDS TRUE: " if self.exceeds else ""
        claim = claim if told else f"{claim[0].upper()}{claim[1:]}"
        return f"{told}{claim}; {left}. {bound} the model."

    def _nobody(self) -> str:
        """Why nobody is scored."""
        if not self.taps:
            return "nobody listened"
        failed = [f"{name}: {why}" for name, why in self.unscored.items() if "failed" in why]
        if not failed and any(why.startswith(UNFINISHED) for why in self.unscored.values()):
            return UNFINISHED
        return "; ".join(failed) or "nobody guessed"


def report(scores: Sequence[RunScore]) -> Report:
    """Pool the scores of runs."""
    claimed = sum(s.truth.claimed_bits for s in scores)
    names = list(dict.fromkeys(t.name for s in scores for t in s.taps))
    taps = []
    for name in names:
        mine = [(s, t) for s in scores for t in s.taps if t.name == name]
        unheard = claimed - sum(s.truth.claimed_bits for s, _ in mine)
        taps.append(_tap(name, mine, unheard, (1 - CONFIDENCE) / len(names)))
    return Report(
        tuple(s.run for s in scores),
        sum(s.truth.transitions for s in scores),
        claimed,
        max((hidden_bits(s.truth) for s in scores), default=0.0),
        tuple(taps),
    )


def hidden_bits(truth: Truth) -> float:
    """f log2(2N + 1) for one width or two candidates, else f log2(M N + 1)."""
    cuts = 2 if truth.hidden_widths == 1 else truth.size
    return truth.hidden_widths * math.log2(cuts * truth.transitions + 1)


def _tap(
    name: str,
    mine: Sequence[tuple[RunScore, EavesdropperScore]],
    unheard: float,
    alpha: float,
) -> TapReport:
    """Her report; ``unheard`` bits were agreed in runs in which she did not listen."""
    scores = [t for _, t in mine if not t.why_unscored]
    size = mine[0][1].size
    keys = known([t.pairs for t in scores], size)
    guessing = Interval(*(max(p, 1.0 / size) for p in keys.share)) if keys.of else keys.share
    by_keys, stated = _left(mine, guessing)
    lists = [t.belief.candidates_left for t in scores if t.belief.candidates_left]
    every = [t for _, t in mine]
    return TapReport(
        name=name,
        runs=len(mine),
        symbol_error_rate=over_runs([t.keys_reviewed for t in scores]).complement(),
        symbol_error_rate_live=over_runs([t.keys for t in scores]).complement(),
        message_bit_error_rate=over_runs([t.bits for t in scores]).complement(),
        exact_message_rate=over_runs([t.messages for t in scores]),
        agreed_steps=keys.of,
        guessing_probability=guessing,
        relabelled=keys.labels,
        left_bits_by_keys=by_keys,
        left_bits_stated=stated,
        given=next((t.belief.given for t in scores if t.belief.given), ""),
        silent_bits=unheard
        + sum(t.silent * math.log2(size) for t in every if not t.messages.every),
        silent_steps=sum(t.silent for t in every),
        unused=sum((Counter(t.unused) for t in every), Counter()),
        unscored=_why_unscored(every),
        leads=any(t.messages.right for t in every) or keys.better_than_chance(alpha),
        list_size=statistics.median(lists) if lists else None,
        broken_at_k=tuple(t.belief.solved_k for t in every),
        size=size,
        keys=tuple(t.belief.keys for t in every if t.belief.keys is not None),
    )


def _why_unscored(scores: Sequence[EavesdropperScore]) -> str:
    reasons = [t.why_unscored for t in scores if t.why_unscored]
    if not reasons:
        return ""
    # a failure is told before a silence
    first = next((why for why in reasons if "failed" in why), reasons[0])
    return first if len(scores) == 1 else f"{first} (in {len(reasons)} of {len(scores)} runs)"


def _left(
    mine: Sequence[tuple[RunScore, EavesdropperScore]], guessing: Interval
) -> tuple[Interval | None, Interval | None]:
    """Bits that she leaves of what she could use: by her keys, and by her own account.

    None where nobody knows it of one of her runs.
    """
    if any(t.why_unscored for _, t in mine):
        return None, None
    size = mine[0][1].size
    open_runs = [(s, t) for s, t in mine if not t.messages.every]
    by_keys = bits_left(sum(_usable(s, t) for s, t in open_runs), size, guessing)
    if not open_runs:
        return Interval(0.0, 0.0, 0.0), None
    parts = [
        # what Eve says of herself, but no more than was agreed
        stated_left(t.stated_left, _usable(s, t) * math.log2(size))
        for s, t in open_runs
        if t.stated_left is not None
    ]
    if not parts:
        return by_keys, None
    guessed = sum(_usable(s, t) for s, t in open_runs if t.stated_left is None)
    parts += [bits_left(guessed, size, guessing)] if guessed else []
    return by_keys, Interval(*(sum(ends) for ends in zip(*parts, strict=True)))


def _usable(run: RunScore, tap: EavesdropperScore) -> int:
    """Agreed steps of a run that she could use."""
    return len(run.truth.keys) - tap.silent


def given(expectation: str) -> str:
    """What an eavesdropper's own account rests on."""
    return f"given {expectation}" if expectation else "by its own account"
