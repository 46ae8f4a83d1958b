"""Secrecy as it is reported: each eavesdropper's guesses beside the truth, and beside the claim.

This is the scoring, and it stands outside the tap: it reads what the tap wrote and the plant's
trace, and nothing in the tap imports it. Only an eavesdropper that runs and guesses is scored: what
one that failed or did not guess leaves is not known. The same holds step by step: of a step that
the tap could not use nothing is known, and it counts neither for the eavesdropper nor as a secret.
What an eavesdropper knows counts, not how she names it (:mod:`protocol.relabelling`). Intervals are
those of :mod:`protocol.statistics`.
"""

import base64
import math
from collections import defaultdict
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from operator import index
from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.messages.adversary import KeysHeld
from protocol.relabelling import KnownSymbols, Pairs, known, pairs_of
from protocol.text import printable
from runtime.recording import TraceError
from tap_service.capture.channel import View
from tap_service.capture.reading import CaptureError
from tap_service.eavesdroppers.base import KEPT_SYMBOLS, Belief, MessageSymbols
from wyner.runs.lines import TRANSITION
from wyner.runs.run import Run, RunError
from wyner.runs.score.by_step import BySteps, Step
from wyner.runs.score.counts import parted, recovered
from wyner.runs.score.plain import plain
from wyner.runs.trace import Trace

ONE_RUN: Final = "shares of one run: no interval (wyner score over runs has them)"
"""Why the shares of a run have no interval."""

UNFINISHED: Final = "unfinished"
SILENT: Final = "it guesses at no symbol of the loop"
DEAF: Final = "it could use none of the steps that agreed a key"


class ScoreError(RunError):
    """A run that cannot be scored; one line."""


@dataclass(frozen=True, slots=True)
class Proportion:
    """Successes and trials; of no trials it says nothing."""

    right: float
    of: int

    @property
    def share(self) -> float | None:
        """Successes over trials."""
        return self.right / self.of if self.of else None

    @property
    def every(self) -> bool:
        """Whether each of them, and there was one."""
        return bool(self.of) and self.right == self.of


@dataclass(frozen=True, slots=True)
class Truth:
    """What really happened in a run, from the plant's trace.

    Parameters
    ----------
    size : int
        M.
    keys : mapping
        The key symbol of each agreed transition, by session and step. The last transition of a
        session is left out: its result never travelled, and its key is never used.
    symbols : mapping
        The message symbol of each message transition.
    whole : tuple of (int, bytes)
        Each message that the plant recovered, with the step (of its session) at which it was whole.
    transitions : int
    hidden_widths : int
        Widths of D_c that one who knows f_c and D_e does not know.
    """

    size: int
    keys: Mapping[Step, int]
    symbols: Mapping[Step, int]
    whole: tuple[tuple[int, bytes], ...]
    transitions: int
    hidden_widths: int = 1

    @property
    def claimed_bits(self) -> float:
        """What the paper's rule counts: log2 M secret bits for each agreement."""
        return len(self.keys) * math.log2(self.size)


@dataclass(frozen=True, slots=True)
class TapOutput:
    """What one eavesdropper said in a run: her guesses, live and reviewed, and her last belief.

    Where she was not ``heard_out``, nobody asked her for the message's symbols. ``behind`` counts
    the steps captured that she never looked at. ``holes`` are the steps of which the tap lacked a
    message although its link to the loop loses none; ``unused`` counts what it could not use
    (:class:`protocol.messages.adversary.UnusedStatus`).
    """

    name: str
    session: str
    live: Mapping[Step, int]
    reviewed: Mapping[Step, int]
    belief: Belief
    message_symbols: MessageSymbols = ()
    failed: str = ""
    heard_out: bool = True
    behind: int = 0
    holes: Container[Step] = ()
    unused: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EavesdropperScore:
    """One eavesdropper's score in one run.

    Parameters
    ----------
    name : str
    keys : Proportion
        Agreed steps that she could use on which her likeliest symbol, right after the step, was the
        key symbol, as she names it. None of one who failed or did not guess.
    keys_reviewed : Proportion
        The same with her second thoughts, where she has any.
    known : KnownSymbols
        What she knows of these symbols, up to one relabelling for all steps.
    bits : Proportion
        Message symbols she got right, step by step; one that she missed counts as a blind guess.
        Where she was not heard to the end, there are none.
    messages : Proportion
        Messages that she had whole and exact, of those the plant recovered; where she keeps only
        the last of hers, of as many of the plant's last.
    belief : Belief
        What she thought of the message in the end.
    size : int
        M.
    failed : str
        Why she stopped, if she did. What she had before counts, what she lacks does not.
    stray : int
        Steps that she takes for the message's, and that are none of it: they shift her frame.
    behind : int
        Steps captured that she never looked at.
    agreed : int
        Steps that agreed a key symbol.
    silent : int
        Of these, the steps that she could not use: the tap did not hear them or could not use what
        it heard, her process was down, or her log was cut. What she leaves of them is not known.
    unused : mapping of str to int
        What the tap could not use, by kind.
    unfinished : bool
        Whether she was stopped before she had looked at all: what she leaves nobody knows then.
    """

    name: str
    keys: Proportion
    keys_reviewed: Proportion
    bits: Proportion
    messages: Proportion
    belief: Belief
    size: int
    pairs: Pairs = field(default_factory=dict)
    failed: str = ""
    stray: int = 0
    behind: int = 0
    agreed: int = 0
    silent: int = 0
    unused: Mapping[str, int] = field(default_factory=dict)
    unfinished: bool = False

    @property
    def stated_left(self) -> float | None:
        """Bits left by her own account, where she gives one: an entropy given what she expects."""
        return None if self.failed else self.belief.bits_left

    @property
    def why_unscored(self) -> str:
        """Why nobody knows what she leaves; empty where it is known."""
        if self.messages.every:
            return ""
        if self.failed:
            return f"it failed: {self.failed}"
        if self.unfinished:
            return UNFINISHED
        if self.keys_reviewed.of:
            return ""
        if self.silent:
            return DEAF
        return "" if self.stated_left is not None else SILENT

    @property
    def known(self) -> KnownSymbols:
        """What she knows of the key symbols, with second thoughts where she has any."""
        return known([self.pairs], self.size)

    def to_json(self) -> dict[str, Any]:
        """What the summary of a run says of her: accuracies, and her guess.

        Accuracies are shares of one run, and `no_interval` says so. ``symbol_accuracy`` counts
        symbols as she names them, ``symbols_known`` those that she knows up to the relabelling
        ``labels``.
        """
        its = self.known
        return {
            "no_interval": ONE_RUN,
            "symbol_accuracy": self.keys_reviewed.share,
            "symbol_accuracy_live": self.keys.share,
            "symbols_known": Proportion(its.right, its.of).share,
            "labels": list(its.labels[0]) if its.labels else None,
            "agreed_steps": self.keys.of,
            "agreed_steps_not_used": self.agreed - self.keys.of,
            "unused": dict(self.unused),
            "message_bit_accuracy": self.bits.share,
            "messages_exact": int(self.messages.right),
            "candidates_left": self.belief.candidates_left,
            "solved_k": self.belief.solved_k,
            "guessed_text": self.belief.message.decode("utf-8", errors="replace"),
            "failed": self.failed,
            "unscored": self.why_unscored,
            "stray_steps": self.stray,
            "steps_not_looked_at": self.behind,
            "keys": plain(self.belief.keys),
        }


@dataclass(frozen=True, slots=True)
class RunScore:
    """The score of a run: the truth's own figures, and each eavesdropper's score."""

    run: str
    truth: Truth
    taps: tuple[EavesdropperScore, ...]

    def to_json(self) -> dict[str, dict[str, Any]]:
        """What the summary says of each eavesdropper."""
        return {tap.name: tap.to_json() for tap in self.taps}


def score(truth: Truth, said: TapOutput) -> EavesdropperScore:
    """Compare what one eavesdropper said with what happened."""
    keys: Mapping[Step, int] = {} if said.failed else _used(truth, said)
    pairs = pairs_of((said.reviewed.get(at, said.live[at]), key) for at, key in keys.items())
    belief = said.belief
    read, of = belief.read_of([payload for _, payload in truth.whole])
    return EavesdropperScore(
        name=said.name,
        keys=Proportion(sum(said.live.get(at) == key for at, key in keys.items()), len(keys)),
        keys_reviewed=Proportion(
            sum(times for (guess, key), times in pairs.items() if guess == key), len(keys)
        ),
        bits=_bits(truth, said),
        messages=Proportion(read, of),
        belief=belief,
        size=truth.size,
        pairs=pairs,
        failed=said.failed,
        stray=_stray(truth, said),
        behind=said.behind,
        agreed=len(truth.keys),
        silent=len(truth.keys) - len(keys) if said.live and not said.failed else 0,
        unused=said.unused,
        unfinished=not (said.heard_out or said.failed),
    )


def _used(truth: Truth, said: TapOutput) -> Mapping[Step, int]:
    """The keys of the agreed steps that she could use: she guessed at them, and all was heard that
    her link lets through.
    """
    return BySteps(
        (at, key) for at, key in truth.keys.items() if at in said.live and at not in said.holes
    )


def _bits(truth: Truth, said: TapOutput) -> Proportion:
    """Message symbols right, of her last session's; of the newest only, where she kept no more."""
    if not said.heard_out or said.failed or not said.live:
        return Proportion(0.0, 0)
    symbols = dict(said.message_symbols)
    oldest = min(symbols) if len(symbols) >= KEPT_SYMBOLS else 0
    asked = missed = right = 0
    for (session, k), symbol in truth.symbols.items():
        if session == said.session and k >= oldest:
            asked += 1
            missed += k not in symbols
            right += symbols.get(k) == symbol
    return Proportion(right + missed / truth.size, asked)


def _stray(truth: Truth, said: TapOutput) -> int:
    """Steps of her last session that she takes for the message's and that are not."""
    return sum((said.session, k) not in truth.symbols for k, _ in said.message_symbols)


class Guesses:
    """What the eavesdroppers of a run guessed, step by step, from the lines of their logs.

    Parameters
    ----------
    lossless : bool
        Whether the tap's link to the loop loses nothing, so that what it lacks was lost in it.
    """

    def __init__(self, *, lossless: bool) -> None:
        self._lossless = lossless
        self._live: defaultdict[str, BySteps] = defaultdict(BySteps)
        self._reviewed: defaultdict[str, BySteps] = defaultdict(BySteps)
        self._holes: defaultdict[str, BySteps] = defaultdict(BySteps)

    def take(self, event: Mapping[str, Any]) -> None:
        """Take a line: a guess, or a second thought."""
        name, at = event["name"], (event["session"], event["k"])
        if event["event"] == "review":
            self._reviewed[name][at] = event["symbol"]
            return
        self._live[name][at] = event["symbol"]
        if self._lossless and event.get("hole"):
            self._holes[name][at] = 1
        else:
            self._holes[name].pop(at, None)  # a process that was started again heard it

    def said(self, record: Mapping[str, Any]) -> TapOutput:
        """All that one of them said, whose record of her beliefs this is."""
        symbols, name = record["symbols"], record["name"]
        belief = Belief(
            message=base64.b64decode(record["message"]),
            whole=tuple(base64.b64decode(w) for w in record["whole"]),
            whole_count=index(record["whole_count"]),
            candidates_left=index(record["candidates_left"]),
            solved_k=index(record["solved_k"]),
            confidence=float(record["confidence"]),
            bits_left=None if record.get("bits_left") is None else float(record["bits_left"]),
            given=printable(str(record.get("given", ""))),
            keys=None if record.get("keys") is None else KeysHeld.model_validate(record["keys"]),
        )
        return TapOutput(
            name=printable(str(name)),
            session=str(record["session"]),
            live=self._live[name],
            reviewed=self._reviewed[name],
            belief=belief,
            message_symbols=[(int(k), int(v)) for k, v in symbols or ()],
            failed=str(record["failed"]),
            heard_out=symbols is not None,
            behind=index(record.get("behind", 0)),
            holes=self._holes[name],
            unused={kind: index(count) for kind, count in record.get("unused", {}).items()},
        )


def read_said(run: Run) -> list[TapOutput]:
    """What each eavesdropper of a run said, from the tap's files.

    Raises
    ------
    ScoreError
        When the tap left nothing that can be read.
    """
    try:
        records = run.beliefs()
    except RunError as error:
        raise ScoreError(str(error)) from None
    guesses = Guesses(lossless=_lossless(run))
    for event in run.guesses():
        guesses.take(event)
    return [guesses.said(record) for record in records.values()]


def _lossless(run: Run) -> bool:
    """Whether the tap's link to the loop loses nothing; so it is where no capture says more."""
    try:
        return View.model_validate(run.capture().header["view"]).hears_all
    except (CaptureError, LookupError, ValueError):
        return True


def read_truth(run: Run) -> Truth:
    """The truth of a run.

    Raises
    ------
    ScoreError
        When its plant's trace cannot be read.
    """
    trace, scenario = the_plant(run), run.scenario
    keys, symbols = _by_step(trace, "symbol"), _by_step(trace, "message_symbol")
    made = np.flatnonzero(trace.steps["kind"] == TRANSITION)
    session, last = np.unique(trace.steps["session"][made][::-1], return_index=True)
    for number, k in zip(
        session.tolist(), trace.steps["k"][made][::-1][last].tolist(), strict=True
    ):
        keys.pop((trace.sessions[number], k), None)  # its result never travelled
    return Truth(
        scenario.secrecy.candidates,
        keys,
        symbols,
        tuple(recovered(trace)),
        len(made),
        scenario.hidden_widths,
    )


def _by_step(trace: Trace, column: str) -> BySteps:
    """A column of the plant's trace, of the steps that have a symbol there."""
    found = BySteps()
    for rows in parted(trace.steps):
        told = rows[rows[column] != NO_SYMBOL]
        fields = (told[name].tolist() for name in ("session", "k", column))
        for session, k, symbol in zip(*fields, strict=True):
            found[trace.sessions[session], k] = symbol
    return found


def the_plant(run: Run) -> Trace:
    """The plant's trace.

    Raises
    ------
    ScoreError
        When it cannot be read.
    """
    try:
        return run.whole("plant")
    except TraceError as error:
        raise ScoreError(str(error)) from None


def score_run(run: Run) -> RunScore:
    """Score every eavesdropper of a run.

    Raises
    ------
    ScoreError
        When the plant's trace or the tap's files cannot be read.
    """
    truth = read_truth(run)
    taps = tuple(score(truth, said) for said in read_said(run))
    return RunScore(run.name, truth, taps)
