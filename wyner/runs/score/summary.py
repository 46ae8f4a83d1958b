"""What a run came to, from its traces, for people and machines: the end of ``wyner up``."""

import base64
import math
from contextlib import suppress
from textwrap import wrap
from typing import Any, Final

import numpy as np

from protocol.agreement import NO_SYMBOL
from protocol.link.session import rules_of
from protocol.relabelling import in_words
from protocol.statistics import COUNTED, Interval
from protocol.text import readable
from runtime.recording import TraceError
from wyner.runs.lines import TRANSITION
from wyner.runs.run import Run
from wyner.runs.score.attacked import attack_lines, attacked
from wyner.runs.score.counts import exchanged, mean_cost, recovered
from wyner.runs.score.keys import audit_keys, key_lines
from wyner.runs.score.report import given, report
from wyner.runs.score.score import (
    DEAF,
    ONE_RUN,
    UNFINISHED,
    RunScore,
    ScoreError,
    score_run,
)
from wyner.runs.score.words import WORDED, unused_in_words
from wyner.runs.trace import columns

GUESS_LENGTH: Final = 72
"""Characters of an eavesdropper's guess that are shown to people."""

NAME_WIDTH: Final = 16

AGAIN: Final = "wyner score --eavesdropper"
"""The command that reads the recording of a run again, at leisure."""

MOST_PAIRS: Final = 1000
"""Messages, the last, of which a summary tells one by one."""

SHOWN_PAIRS: Final = 5
"""The same for people, after the first."""


def summarise(run: Run, payload: bytes) -> dict[str, Any]:
    """What a run came to, from its traces.

    ``sent`` and ``recovered`` are exact where the message is text (``*_base64`` always).
    ``recovered`` is what arrived of ``payload``; ``delivered_k`` is the step at which the plant had
    it whole, -1 never. ``exchanged`` has so much of every message, the last 1000 of them.
    ``bits_per_second`` counts message bits over plant time, missed steps included, and that of
    every journal the plant had. ``control_cost`` is the mean of x' Q x + u' R u a step.
    ``trace_error`` says from where on a trace cannot be read, and what is summed up is
    what stands before; it is empty where all of it can.
    ``claimed_bits`` is what the paper's rule counts, of whichever law, ``true_bits`` what the
    strongest eavesdropper of this run leaves at most of the steps that it could use,
    ``true_bits_interval`` with its limits (None: nobody was scored, and ``unscored`` says why of
    each). ``true_bits_by_keys`` is the same by its keys alone, ``true_bits_stated`` by its own
    account, an entropy given the expectation ``given`` (None: it gives none); ``labels`` relabels
    its symbols (None: they count as named). Of ``silent_bits``, the steps that it could not use,
    nothing is known. ``no_interval`` says why
    figures have none. ``failed`` names the
    eavesdroppers that failed. ``keys`` is what :func:`wyner.runs.score.keys.audit_keys` finds, None
    where the scenario makes none; ``under_keys`` says whether the message travels under them.
    ``attack`` is what :func:`wyner.runs.score.attacked.attacked` finds.
    """
    scenario = run.scenario
    size, scheme = scenario.secrecy.candidates, rules_of(scenario).scheme
    errors: list[str] = []
    trace = run.so_far("plant", errors)
    none = np.zeros(0, columns("plant", rules_of(scenario), truth=False))
    rows = none if trace is None else trace.steps
    made, agreed = rows["kind"] == TRANSITION, rows["symbol"] != NO_SYMBOL
    wrong = 0 if scheme.corrects else int((rows["symbol"] != rows["coin"])[agreed].sum())
    whole = [] if trace is None else recovered(trace)
    sent: list[bytes] = []
    try:
        sent = run.sent()
    except TraceError as error:
        errors.append(str(error))
    pairs = exchanged(sent or [payload], whole)
    delivered_k = next((k for text, k in pairs if text == payload), -1)
    arrived = payload if delivered_k >= 0 else b""
    bits = int((rows["message_symbol"] != NO_SYMBOL).sum()) * math.log2(size)
    transitions, agreements = int(made.sum()), int(agreed.sum())
    steps = len(rows) + (0 if trace is None else trace.behind)
    seconds = steps * scenario.plant.period_s
    return {
        "delivered": delivered_k >= 0,
        "delivered_k": delivered_k,
        "sent": _text(payload),
        "sent_base64": base64.b64encode(payload).decode(),
        "recovered": _text(arrived),
        "recovered_base64": base64.b64encode(arrived).decode(),
        "messages": len(whole),
        "exchanged": [
            {"sent_base64": base64.b64encode(text).decode(), "recovered_k": k}
            for text, k in pairs[-MOST_PAIRS:]
        ],
        "steps": steps,
        "seconds": seconds,
        "transitions": transitions,
        "missed": steps - transitions,
        "control_cost": mean_cost(rows, scenario.cost_weights),
        "agreements": agreements,
        "symbol_errors": wrong,
        "bits": bits,
        "bits_per_second": bits / seconds if seconds else 0.0,
        "no_interval": {"bits_per_second": COUNTED, "control_cost": COUNTED},
        **_secrecy(run, agreements * math.log2(size)),
        "unguessed": run.unguessed(),
        "keys": None if (keys := audit_keys(run, scenario)) is None else keys.as_json(),
        "under_keys": scheme.from_stream,
        "attack": attacked(run),
        "trace_error": "; ".join(errors),
        "run_dir": str(run.folder),
    }


def _secrecy(run: Run, claimed: float) -> dict[str, Any]:
    """What the paper's rule counts, what is left of it at most, and each one's score."""
    score: RunScore | None = None
    with suppress(ScoreError):
        score = score_run(run)
    found = None if score is None else report([score])
    best = None if found is None else found.strongest

    def high(left: Interval | None) -> float | None:
        return None if left is None else left.high

    left = None if best is None else best.left_bits
    return {
        "claimed_bits": claimed if score is None else score.truth.claimed_bits,
        "true_bits": high(left),
        "true_bits_interval": None if left is None else left.as_json(),
        "true_bits_by_keys": None if best is None else high(best.left_bits_by_keys),
        "true_bits_stated": None if best is None else high(best.left_bits_stated),
        "given": "" if best is None else best.given,
        "labels": list(best.relabelled[0]) if best and best.relabelled else None,
        "silent_bits": 0.0 if best is None else best.silent_bits,
        "silent_steps": 0 if best is None else best.silent_steps,
        "strongest": "" if best is None else best.name,
        "unscored": {} if found is None else found.unscored,
        "failed": [] if score is None else [tap.name for tap in score.taps if tap.failed],
        "taps": {} if score is None else score.to_json(),
    }


def _text(payload: bytes) -> str:
    return payload.decode("utf-8", errors="replace")


def render(summary: dict[str, Any]) -> str:
    """The summary for people; its last lines are the verdict."""
    recovered = base64.b64decode(summary["recovered_base64"])
    got = readable(recovered) if recovered else "(the run ended before the message was whole)"
    errors = summary["symbol_errors"]
    lines = [
        f"sent       {readable(base64.b64decode(summary['sent_base64']))}",
        f"recovered  {got}",
        *_others(summary),
        f"loop       {summary['steps']} steps ({summary['missed']} missed), "
        f"{summary['seconds']:.0f} s of plant time",
        "agreed     "
        + (
            "none by the paper's rule: the message travels under distilled keys"
            if summary["under_keys"]
            else f"{summary['agreements']} keys, {f'{errors} WRONG' if errors else 'none wrong'}"
        ),
        f"carried    {summary['bits']:.0f} message bits, "
        f"{summary['bits_per_second']:.2f} a second of plant time, counted",
        *cost_lines(summary["control_cost"]),
    ]
    if summary["trace_error"]:
        lines.append(f"trace      damaged, counted up to there: {summary['trace_error']}")
    lines += [
        f"Eve        {name:<{NAME_WIDTH}}{_got(tap, summary['messages'])}"
        for name, tap in summary["taps"].items()
    ]
    for name, tap in summary["taps"].items():
        if told := unused_in_words(tap["unused"]):
            lines += _folded(f"Eve        {name:<{NAME_WIDTH}}", f"not used: {told}")
        if tap["steps_not_looked_at"]:
            late = f"{tap['steps_not_looked_at']} steps not read yet: {AGAIN}"
            lines.append(f"Eve        {name:<{NAME_WIDTH}}{late}")
    if summary["taps"]:
        lines.append(f"           {ONE_RUN}")
    if summary["unguessed"]:
        left = f"{summary['unguessed']} messages were not guessed at live"
        lines.append(f"Eve        {left}: {AGAIN}")
    lines.append(f"run        {summary['run_dir']}")
    return "\n".join([*lines, *verdict_lines(summary)])


def cost_lines(cost: float | None) -> list[str]:
    """The control cost in a line; none of a plant that made no step."""
    return [] if cost is None else [f"cost       {cost:.4g} a step, x' Q x + u' R u"]


def _others(summary: dict[str, Any]) -> list[str]:
    """The messages that were sent while it ran, each with the step at which it was there."""
    pairs = summary["exchanged"]
    first = next((i for i, p in enumerate(pairs) if p["sent_base64"] == summary["sent_base64"]), -1)
    others = [pair for i, pair in enumerate(pairs) if i != first]
    lines = [f"besides    {len(others) - SHOWN_PAIRS} more"] if len(others) > SHOWN_PAIRS else []
    for pair in others[-SHOWN_PAIRS:]:
        k = pair["recovered_k"]
        there = f"recovered at step {k}" if k >= 0 else "not recovered"
        text = readable(base64.b64decode(pair["sent_base64"]))
        lines.append(f"besides    {in_short(text)}, {there}")
    return lines


def verdict_lines(summary: dict[str, Any]) -> list[str]:
    """The point of a run: who had the message when, what counts as secret, and what is."""
    if summary["delivered"]:
        plant = f"had the message at step {summary['delivered_k']}"
    else:
        plant = f"has not got the message whole in {summary['steps']} steps"
    lines = [f"The plant  {plant}."]
    had = {name: tap["solved_k"] for name, tap in summary["taps"].items() if tap["messages_exact"]}
    if had:
        name = min(had, key=lambda n: (had[n] < 0, had[n]))
        when = f"at step {had[name]}" if had[name] >= 0 else "too, without being sure of it"
        lines.append(f"Eve        had it {when}, from what everyone can read ({name}).")
    elif summary["taps"]:
        lines.append("Eve        has not got it whole.")
    else:
        lines.append("Eve        was not there.")
    if summary["under_keys"]:
        lines.append(f"Secret     {_under_keys(summary['keys'])}")
    else:
        lines.append(
            f"Secret     {summary['claimed_bits']:.0f} bits by the paper's rule. True: "
            f"{true_in_words(summary)}."
        )
    lines += [f"           {text}" for text in true_rests_on(summary)]
    lines += [f"FAILED     {name}: {summary['taps'][name]['failed']}" for name in summary["failed"]]
    if summary["keys"] is not None:
        lines += key_lines(summary["keys"])
    if summary["attack"] is not None:
        lines += attack_lines(summary["attack"])
    return lines


def _under_keys(keys: dict[str, Any]) -> str:
    """How secret a message is that travelled under distilled keys."""
    if not keys["made"]:
        return "No key was made, and so nothing of the message was sent."
    held, missed = keys["held_by_tap_bits"], keys["missed_by_tap"]
    if held is None or missed is None:
        return "The message travels under distilled keys: it is as secret as they are."
    heard = f"Eve missed {100 * missed:.2g} % of the messages"
    return f"{heard}, and holds {held} bits of the keys that this one travels under."


def true_in_words(summary: dict[str, Any]) -> str:
    """What is left of the bits that count as secret, or why nobody knows."""
    true = summary["true_bits"]
    if true is not None:
        of = ""
        if summary["silent_bits"]:
            of = f" of {summary['claimed_bits'] - summary['silent_bits']:.0f}"
        return f"at most {true:.0f}{of} ({summary['strongest']})"
    if summary["failed"]:
        return "unknown, Eve failed"
    if any(tap["unscored"].startswith(UNFINISHED) for tap in summary["taps"].values()):
        return f"unknown, {UNFINISHED}"
    if any(tap["unscored"] == DEAF for tap in summary["taps"].values()):
        return "unknown, Eve could use no step"
    return "unknown, nobody guessed" if summary["taps"] else "unknown, nobody listened"


def true_rests_on(summary: dict[str, Any]) -> list[str]:
    """What must stand beside the true bits: an expectation, a relabelling, steps not used."""
    if summary["true_bits"] is None:
        return []
    lines = []
    stated, by_keys = summary["true_bits_stated"], summary["true_bits_by_keys"]
    if stated is not None and by_keys is not None:
        lines.append(
            f"At most {stated:.0f} {given(summary['given'])}; by keys alone at most {by_keys:.0f}."
        )
    labels = summary["labels"]
    if labels is not None:
        how = f": {in_words(labels)}" if len(labels) <= WORDED else ""
        lines += _folded("", f"Eve's symbols count relabelled{how}.")
    if summary["silent_bits"]:
        lines.append(f"The other {summary['silent_bits']:.0f} bits are not known to be secret:")
        lines.append(f"Eve could not use {summary['silent_steps']} agreed steps.")
    return lines


def _folded(head: str, text: str) -> list[str]:
    """A text after a head, in lines that fit a terminal of 80 columns."""
    lines = wrap(text, 80 - max(len(head), 11))
    return [head + lines[0], *(" " * len(head) + line for line in lines[1:])]


def _got(tap: dict[str, Any], recovered: int) -> str:
    """What one eavesdropper got, in a line, of so many messages that the plant recovered."""

    def share(value: float | None) -> str:
        return "    -  " if value is None else f"{100 * value:5.1f} %"

    if tap["failed"]:
        return "FAILED: not scored" + (", had a message whole" if tap["messages_exact"] else "")
    if tap["unscored"]:
        on = f": {AGAIN}" if tap["unscored"] == UNFINISHED else ""
        return f"not scored: {tap['unscored']}{on}"
    whole = "whole" if tap["messages_exact"] else "not whole"
    if not recovered:
        whole = "none was whole yet"
    elif not tap["messages_exact"] and tap["stray_steps"]:
        # each of the message's symbols may be right: others stand between them, and no frame fits
        stray = tap["stray_steps"]
        whole = f"{stray} bit{'s' if stray > 1 else ''} too many"
    return (
        f"{share(tap['symbols_known'])} of keys, "
        f"{share(tap['message_bit_accuracy'])} of bits, {whole}"
    )


def in_short(guess: str) -> str:
    """An eavesdropper's guess, quoted, in what fits a line: it may be pages of garbage."""
    text = readable(guess.encode(errors="replace"))
    return repr(text if len(text) <= GUESS_LENGTH else text[: GUESS_LENGTH - 1] + "…")
