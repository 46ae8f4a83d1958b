"""What a run came to, from its traces: for the last line of ``wyner up`` and for people."""

import base64
import math
from pathlib import Path
from typing import Any, Final

from protocol.runtime.trace import PLANT_TRACE, SCENARIO, TraceError, TraceReader
from protocol.scenario import load_scenario
from protocol.schemes.framing import readable
from wyner.scoring.score import ScoreError, score_run, summary_of

GUESS_LENGTH: Final = 72
"""Characters of an eavesdropper's guess that are shown to people."""


def summarise(run_dir: Path, payload: bytes) -> dict[str, Any]:
    """What a run came to, from its traces.

    ``bits_per_second`` counts message bits over plant time, missed steps included.
    """
    scenario = load_scenario(run_dir / SCENARIO)
    size = scenario.secrecy.candidates
    steps: set[int] = set()
    transitions: dict[tuple[str, int], dict[str, Any]] = {}
    recovered: list[bytes] = []
    try:
        for event in TraceReader(run_dir / PLANT_TRACE):
            if event["event"] in ("transition", "missed"):
                steps.add(event["k"])
            if event["event"] == "transition":
                transitions[event["session"], event["j"]] = event
            elif event["event"] == "recovered":
                recovered.append(base64.b64decode(event["payload"]))
    except TraceError:
        pass
    agreed = [t for t in transitions.values() if t["symbol"] >= 0]
    symbols = sum(t["message_symbol"] >= 0 for t in transitions.values())
    bits = symbols * math.log2(size)
    seconds = len(steps) * scenario.plant.period_s
    try:
        taps = summary_of(score_run(run_dir))
    except ScoreError:
        taps = {}
    return {
        "delivered": payload in recovered,
        "sent": readable(payload),
        "recovered": readable(recovered[-1]) if recovered else "",
        "steps": len(steps),
        "transitions": len(transitions),
        "missed": len(steps) - len({t["k"] for t in transitions.values()}),
        "agreements": len(agreed),
        "symbol_errors": sum(t["symbol"] != t["coin"] for t in agreed),
        "bits": bits,
        "bits_per_second": bits / seconds if seconds else 0.0,
        "taps": taps,
        "run_dir": str(run_dir),
    }


def render(summary: dict[str, Any]) -> str:
    """The summary for people."""
    lines = [
        f"sent       {summary['sent']}",
        f"recovered  {summary['recovered'] or '(nothing whole)'}",
        f"steps      {summary['steps']} ({summary['missed']} missed), "
        f"{summary['agreements']} keys agreed, {summary['symbol_errors']} unlike the plant's coin",
        f"carried    {summary['bits']:.0f} bits, "
        f"{summary['bits_per_second']:.2f} bits per second of plant time",
    ]
    for name, tap in summary["taps"].items():
        lines.append(f"tap        {name}: {_describe(tap)}")
    lines.append(f"run        {summary['run_dir']}")
    return "\n".join(lines)


def _describe(tap: dict[str, Any]) -> str:
    """What one eavesdropper got, in a line."""

    def share(value: float | None) -> str:
        return "none to score" if value is None else f"{100 * value:.1f} %"

    return (
        f"{share(tap['symbol_accuracy'])} of agreed keys, "
        f"{share(tap['message_bit_accuracy'])} of message bits, "
        f"guessed {in_short(tap['guessed_text'])}"
    )


def in_short(guess: str) -> str:
    """An eavesdropper's guess, quoted, in what fits a line: it may be pages of garbage."""
    text = readable(guess.encode(errors="replace"))
    return repr(text if len(text) <= GUESS_LENGTH else text[: GUESS_LENGTH - 1] + "…")
