"""The secrecy report over runs: what the paper claims and what each eavesdropper leaves of it."""

import math
import random
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from tap_service.eavesdroppers.base import KeysHeld
from wyner.scoring.score import EavesdropperScore, Proportion, RunScore

RESAMPLES: Final = 2000
FEWEST_RUNS: Final = 5
"""From this many runs on, intervals come from resampling whole runs: steps within one depend."""

BOUND: Final = (
    "The keys are a function of the public transcript and the secret part of the model, so that "
    "H(keys | transcript) <= H(model | transcript): however many keys are agreed, what stays "
    "hidden is at most what the eavesdropper does not yet know of the model. For one who knows "
    "f_c and the shape of D_e that is two thresholds, worth at most 2 log2(N + 1) bits after N "
    "steps."
)


@dataclass(frozen=True, slots=True)
class Portion:
    """A pooled share with its 95 % interval."""

    value: float | None
    low: float
    high: float
    of: int

    @classmethod
    def over(cls, parts: Sequence[Proportion]) -> "Portion":
        """Pool runs: bootstrap over them where there are enough, else Wilson over all trials."""
        pooled = Proportion(sum(p.right for p in parts), sum(p.of for p in parts))
        low, high = pooled.interval
        used = [p for p in parts if p.of]
        if len(used) >= FEWEST_RUNS and 0 < pooled.right < pooled.of:
            draw = random.Random(0)
            shares = []
            for _ in range(RESAMPLES):
                sample = draw.choices(used, k=len(used))
                shares.append(sum(p.right for p in sample) / sum(p.of for p in sample))
            shares.sort()
            low, high = shares[int(0.025 * RESAMPLES)], shares[int(0.975 * RESAMPLES) - 1]
        return cls(pooled.share, low, high, pooled.of)

    @classmethod
    def wilson(cls, parts: Sequence[Proportion]) -> "Portion":
        """Pool trials that do not depend on one another, such as messages of separate runs."""
        pooled = Proportion(sum(p.right for p in parts), sum(p.of for p in parts))
        return cls(pooled.share, *pooled.interval, pooled.of)

    def error(self) -> "Portion":
        """The complement: an error rate."""
        value = None if self.value is None else 1 - self.value
        return Portion(value, 1 - self.high, 1 - self.low, self.of)

    def text(self) -> str:
        """As a table shows it."""
        if self.value is None:
            return "-"
        return f"{100 * self.value:.1f} % [{100 * self.low:.1f}, {100 * self.high:.1f}]"


@dataclass(frozen=True, slots=True)
class TapReport:
    """One eavesdropper over all runs.

    Parameters
    ----------
    symbol_errors : Share
        Of agreed steps, with second thoughts where she has any.
    symbol_errors_live : Share
        The same right after each step.
    bit_errors : Share
        Of message symbols.
    exact : Share
        Messages had whole and exact, of those the plant recovered.
    guessing : float, optional
        P_g per key symbol.
    min_entropy : float, optional
        -log2 P_g, in bits.
    left_bits : float, optional
        Of all claimed bits, what she leaves by that measure; 0 once she had every message.
    list_size : float, optional
        Median of the candidate messages that remained.
    broken_k : tuple of int
        Steps at which she first was sure of a whole message, run by run; -1 never.
    not_on_record : int
        Agreed steps for which there is no word of hers, because her log was cut or she was gone.
    size : int
        M.
    keys : tuple of KeysHeld
        What she holds of distilled keys, run by run, where she goes for them.
    """

    name: str
    runs: int
    symbol_errors: Portion
    symbol_errors_live: Portion
    bit_errors: Portion
    exact: Portion
    guessing: float | None
    min_entropy: float | None
    left_bits: float | None
    list_size: float | None
    broken_k: tuple[int, ...]
    not_on_record: int
    size: int
    keys: tuple[KeysHeld, ...] = ()

    @property
    def median_broken(self) -> float | None:
        """Median step at which she broke it, over the runs in which she did."""
        broken = [k for k in self.broken_k if k >= 0]
        return statistics.median(broken) if broken else None


@dataclass(frozen=True, slots=True)
class Report:
    """The secrecy report.

    Parameters
    ----------
    claimed_bits : float
        What the paper's rule counts over all runs: every agreement as log2 M secret bits.
    hidden_bits : float
        Bound on what stays hidden of one run's keys from one who knows the model: the thresholds.
    """

    runs: tuple[str, ...]
    transitions: int
    claimed_bits: float
    hidden_bits: float
    taps: tuple[TapReport, ...]

    @property
    def strongest(self) -> TapReport | None:
        """The eavesdropper who leaves the least."""
        scored = [t for t in self.taps if t.left_bits is not None]

        def weakness(t: TapReport) -> tuple[float, float, float]:
            return t.left_bits or 0.0, -(t.exact.value or 0.0), t.symbol_errors.value or 0.0

        return min(scored, key=weakness, default=None)

    @property
    def exceeds(self) -> bool:
        """Whether the paper's claim is shown to be more than the strongest eavesdropper leaves."""
        strongest = self.strongest
        if strongest is None or strongest.left_bits is None or self.claimed_bits == 0:
            return False
        return strongest.left_bits < 0.99 * self.claimed_bits and (
            strongest.symbol_errors.high < 1 - 1 / strongest.size
            or (strongest.exact.value or 0) > 0
        )

    def verdict(self) -> str:
        """In words."""
        strongest = self.strongest
        if self.claimed_bits == 0:
            return "No key was agreed; the paper claims nothing and nothing can be lost."
        if strongest is None or strongest.left_bits is None:
            return "No eavesdropper was scored; the paper's claim stands untested."
        claim = f"the paper claims {self.claimed_bits:.0f} secret bits"
        left = f"{strongest.name} leaves {strongest.left_bits:.1f} of them, guessed one by one"
        bound = f"All together hide at most {self.hidden_bits:.1f} bits a run from one who knows"
        told = "PAPER'S CLAIM EXCEEDS TRUE: " if self.exceeds else ""
        claim = claim if told else claim.capitalize()
        return f"{told}{claim}; {left}. {bound} the model."


def report(scores: Sequence[RunScore]) -> Report:
    """Pool the scores of runs."""
    claimed = sum(s.truth.claimed_bits for s in scores)
    names = list(dict.fromkeys(t.name for s in scores for t in s.taps))
    longest = max((s.truth.transitions for s in scores), default=0)
    taps = []
    for name in names:
        mine = [(s, t) for s in scores for t in s.taps if t.name == name]
        taps.append(_tap(name, mine))
    return Report(
        tuple(s.run for s in scores),
        sum(s.truth.transitions for s in scores),
        claimed,
        2 * math.log2(longest + 1),
        tuple(taps),
    )


def _tap(name: str, mine: Sequence[tuple[RunScore, EavesdropperScore]]) -> TapReport:
    scores = [t for _, t in mine]
    keys = Portion.over([t.keys_reviewed for t in scores])
    size = scores[0].size
    guessing = None if keys.value is None else max(keys.value, 1.0 / size)
    entropy = None if guessing is None else abs(math.log2(guessing))
    left = None
    if entropy is not None:
        # where she has every message, nothing of that run's keys is left
        left = sum(
            0.0
            if t.messages.of and t.messages.right == t.messages.of
            else entropy * len(s.truth.keys)
            for s, t in mine
        )
    lists = [t.candidates_left for t in scores if t.candidates_left]
    return TapReport(
        name=name,
        runs=len(scores),
        symbol_errors=keys.error(),
        symbol_errors_live=Portion.over([t.keys for t in scores]).error(),
        bit_errors=Portion.over([t.bits for t in scores]).error(),
        exact=Portion.wilson([t.messages for t in scores]),
        guessing=guessing,
        min_entropy=entropy,
        left_bits=left,
        list_size=statistics.median(lists) if lists else None,
        broken_k=tuple(t.solved_k for t in scores),
        not_on_record=sum(len(s.truth.keys) - t.keys.of for s, t in mine),
        size=size,
        keys=tuple(t.held for t in scores if t.held is not None),
    )


def as_json(r: Report) -> dict[str, Any]:
    """The report as one object."""

    def share(s: Portion) -> dict[str, Any]:
        return {"value": s.value, "low": s.low, "high": s.high, "of": s.of}

    strongest = r.strongest
    return {
        "runs": list(r.runs),
        "transitions": r.transitions,
        "claimed_bits": r.claimed_bits,
        "hidden_bits_bound": r.hidden_bits,
        "claimed_exceeds_true": r.exceeds,
        "strongest": None if strongest is None else strongest.name,
        "verdict": r.verdict(),
        "bound": BOUND,
        "taps": {
            t.name: {
                "runs": t.runs,
                "symbol_error_rate": share(t.symbol_errors),
                "symbol_error_rate_live": share(t.symbol_errors_live),
                "message_bit_error_rate": share(t.bit_errors),
                "exact_message_rate": share(t.exact),
                "guessing_probability": t.guessing,
                "min_entropy_bits": t.min_entropy,
                "left_bits": t.left_bits,
                "list_size": t.list_size,
                "list_size_log2": None if not t.list_size else math.log2(t.list_size),
                "broken_at_k": list(t.broken_k),
                "not_on_record": t.not_on_record,
                "keys": [held.model_dump() for held in t.keys],
            }
            for t in r.taps
        },
    }


HEADINGS: Final = (
    "eavesdropper",
    "symbol errors",
    "bit errors",
    "messages exact",
    "P_g",
    "bits/key",
    "list",
    "broken at k",
)


def rows(r: Report) -> list[tuple[str, ...]]:
    """The report as a table's rows, under :data:`HEADINGS`."""

    def number(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    return [
        (
            t.name,
            t.symbol_errors.text(),
            t.bit_errors.text(),
            t.exact.text(),
            number(t.guessing, ".3f"),
            number(t.min_entropy, ".3f"),
            number(t.list_size, ".0f"),
            number(t.median_broken, ".0f"),
        )
        for t in r.taps
    ]


def held_line(held: KeysHeld) -> str:
    """What one who goes for keys holds, in words."""
    line = f"holds {held.bits} bits of {held.broken} of {held.blocks} key blocks"
    if held.sealed:
        known, bits = (sum(getattr(t, f) for t in held.sealed) for f in ("known_bits", "bits"))
        line += f"; reads {known} of {bits} bits of sealed text"
        line += "".join(f', "{t.text}"' for t in held.sealed if t.known_bits)
    return line
