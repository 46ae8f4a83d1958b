"""What a run came to, from its traces, for people and machines: the end of ``wyner up``."""

import base64
import json
import math
from pathlib import Path
from typing import Any, Final

from protocol.runtime.run_folder import PLANT_TRACE, SCENARIO, TAP_STATUS
from protocol.runtime.trace import TraceError, TraceReader
from protocol.scenario import load_scenario
from protocol.text import readable
from wyner.scoring.keys import audit_keys, key_lines
from wyner.scoring.report import report
from wyner.scoring.score import RunScore, ScoreError, score_run, summary_of

GUESS_LENGTH: Final = 72
"""Characters of an eavesdropper's guess that are shown to people."""

NAME_WIDTH: Final = 16


def summarise(run_dir: Path, payload: bytes) -> dict[str, Any]:
    """What a run came to, from its traces.

    ``sent`` and ``recovered`` are exact where the message is text (``*_base64`` always).
    ``delivered_k`` is the step at which the plant had ``payload`` whole, -1 never.
    ``bits_per_second`` counts message bits over plant time, missed steps included.
    ``claimed_bits`` is what the paper's rule counts, ``true_bits`` what the strongest eavesdropper
    of this run leaves of it (None: nobody was scored); of ``unguessed`` messages, which the tap
    recorded and left out of its live guessing, it says too little. ``keys`` is what
    :func:`wyner.scoring.keys.audit_keys` finds, None where the scenario makes none.
    """
    scenario = load_scenario(run_dir / SCENARIO)
    size = scenario.secrecy.candidates
    steps: set[int] = set()
    transitions: dict[tuple[str, int], dict[str, Any]] = {}
    recovered: list[bytes] = []
    delivered_k = last_k = -1
    try:
        for event in TraceReader(run_dir / PLANT_TRACE):
            if event["event"] in ("transition", "missed"):
                steps.add(event["k"])
            if event["event"] == "transition":
                transitions[event["session"], event["j"]] = event
                last_k = event["k"]
            elif event["event"] == "recovered":
                recovered.append(base64.b64decode(event["payload"]))
                if recovered[-1] == payload and delivered_k < 0:
                    delivered_k = last_k
    except TraceError:
        pass
    agreed = [t for t in transitions.values() if t["symbol"] >= 0]
    symbols = sum(t["message_symbol"] >= 0 for t in transitions.values())
    bits = symbols * math.log2(size)
    seconds = len(steps) * scenario.plant.period_s
    last = recovered[-1] if recovered else b""
    return {
        "delivered": payload in recovered,
        "delivered_k": delivered_k,
        "sent": _text(payload),
        "sent_base64": base64.b64encode(payload).decode(),
        "recovered": _text(last),
        "recovered_base64": base64.b64encode(last).decode(),
        "messages": len(recovered),
        "steps": len(steps),
        "seconds": seconds,
        "transitions": len(transitions),
        "missed": len(steps) - len({t["k"] for t in transitions.values()}),
        "agreements": len(agreed),
        "symbol_errors": sum(t["symbol"] != t["coin"] for t in agreed),
        "bits": bits,
        "bits_per_second": bits / seconds if seconds else 0.0,
        **_secrecy(run_dir, len(agreed) * math.log2(size)),
        "unguessed": _unguessed(run_dir),
        "keys": None if (keys := audit_keys(run_dir, scenario)) is None else keys.as_json(),
        "run_dir": str(run_dir),
    }


def _secrecy(run_dir: Path, claimed: float) -> dict[str, Any]:
    """What the paper claims, what the strongest eavesdropper leaves of it, and each one's score."""
    try:
        score: RunScore = score_run(run_dir)
    except ScoreError:
        return {"claimed_bits": claimed, "true_bits": None, "strongest": "", "taps": {}}
    strongest = report([score]).strongest
    return {
        "claimed_bits": score.truth.claimed_bits,
        "true_bits": None if strongest is None else strongest.left_bits,
        "strongest": "" if strongest is None else strongest.name,
        "taps": summary_of(score),
    }


def _unguessed(run_dir: Path) -> int:
    """Messages that the tap left out of its live guessing, since too many waited."""
    try:
        return int(json.loads((run_dir / TAP_STATUS).read_bytes())["unguessed"])
    except (OSError, ValueError, LookupError, TypeError):
        return 0


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
        f"loop       {summary['steps']} steps ({summary['missed']} missed), "
        f"{summary['seconds']:.0f} s of plant time, {summary['agreements']} keys agreed, "
        + (f"{errors} WRONG" if errors else "none wrong"),
        f"carried    {summary['bits']:.0f} message bits, "
        f"{summary['bits_per_second']:.2f} a second of plant time",
    ]
    lines += [
        f"Eve        {name:<{NAME_WIDTH}}{_got(tap)}" for name, tap in summary["taps"].items()
    ]
    if summary["unguessed"]:
        left = f"{summary['unguessed']} messages waited too long to be guessed at live"
        lines.append(f"Eve        {left}: wyner replay")
    lines.append(f"run        {summary['run_dir']}")
    return "\n".join([*lines, *verdict_lines(summary)])


def verdict_lines(summary: dict[str, Any]) -> list[str]:
    """The point of a run in three lines: who had the message when, and what the paper claims."""
    if summary["delivered"]:
        plant = f"had the message at step {summary['delivered_k']}"
    else:
        plant = f"has not got the message in {summary['steps']} steps"
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
    true = summary["true_bits"]
    shown = "unknown, no eavesdropper was scored" if true is None else f"{true:.0f}, measured"
    if true is not None and summary["unguessed"]:
        shown = f"at most {true:.0f}"
    lines.append(
        f"Secret     the paper claims {summary['claimed_bits']:.0f} bits. True: {shown}"
        + (f" ({summary['strongest']})." if true is not None else ".")
    )
    if summary["keys"] is not None:
        lines += key_lines(summary["keys"])
    return lines


def _got(tap: dict[str, Any]) -> str:
    """What one eavesdropper got, in a line."""

    def share(value: float | None) -> str:
        return "    -  " if value is None else f"{100 * value:5.1f} %"

    whole = "whole" if tap["messages_exact"] else "not whole"
    return (
        f"{share(tap['symbol_accuracy'])} of keys, "
        f"{share(tap['message_bit_accuracy'])} of message bits, {whole}"
    )


def in_short(guess: str) -> str:
    """An eavesdropper's guess, quoted, in what fits a line: it may be pages of garbage."""
    text = readable(guess.encode(errors="replace"))
    return repr(text if len(text) <= GUESS_LENGTH else text[: GUESS_LENGTH - 1] + "…")
