"""``wyner score CAPTURE``: feed a recorded capture to eavesdroppers, all on one transcript."""

import argparse
from pathlib import Path
from typing import Any


def decode(args: argparse.Namespace, path: Path) -> int:
    """Decode, and print what each eavesdropper made of it."""
    import json
    import sys

    from runtime.errors import DONE, FAILED, UsageError
    from runtime.scenario_file import scenario_of
    from tap_service.capture.reading import CaptureError, CaptureReader
    from tap_service.command import names_of
    from tap_service.eavesdroppers import DEFAULT, KnowledgeError
    from wyner.runs.score.replay import Replay

    scenario = None if args.scenario is None else scenario_of(args.scenario)
    try:
        names = names_of(args.eavesdropper) or tuple(
            CaptureReader(path).header.get("eavesdroppers") or DEFAULT
        )
        replay = Replay(path, names, scenario=scenario)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    except KnowledgeError as error:
        raise UsageError(f"--eavesdropper: {error}") from None
    try:
        replay.run()
    except CaptureError as error:  # of a part that came later
        raise UsageError(str(error)) from None
    report = replay.report()
    if args.json:
        print(json.dumps(report))
    else:
        _print(report)
    if torn := replay.reader.torn:
        print(f"replay: {torn} torn lines were left out", file=sys.stderr)
    if missing := replay.reader.parts_missing:
        print(f"replay: {missing} parts of the capture are missing", file=sys.stderr)
    return FAILED if any(tap["failed"] for tap in report["taps"].values()) else DONE


def _print(report: dict[str, Any]) -> None:
    from protocol.text import printable
    from tap_service.eavesdroppers.base import KeysHeld
    from wyner.runs.score.report import held_line, unused_in_words
    from wyner.runs.score.summary import in_short

    taps = report["taps"]
    assert isinstance(taps, dict)
    print(f"{report['transitions']} transitions, {report['holes']} with something missing")
    unused = {name: report[name] for name in ("foreign", "late", "jumped")}
    if told := unused_in_words(unused):
        print(f"not used of what the tap heard: {told}")
    for name, tap in taps.items():
        if tap["failed"]:
            print(printable(f"{name}: it failed: {tap['failed']}"))
            continue
        solved = (
            f"first whole message at k {tap['solved_k']}" if tap["solved_k"] >= 0 else "none whole"
        )
        print(f"{name}: {solved}, {tap['candidates_left']} candidates left")
        print(f"  best message: {in_short(tap['message'])}")
        if tap["keys"] is not None:
            print(printable(f"  {held_line(KeysHeld.model_validate(tap['keys']))}"))
