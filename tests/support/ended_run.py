"""A run with all that a run leaves: recordings, journals, the manifest, what the tap said."""

import json
from pathlib import Path

from runtime.files import write_atomically
from runtime.run_folder import (
    CAPTURE,
    MANIFEST,
    TAP_STATUS,
)
from tests.support.recorded_pair import RecordedPair, read_lines


def ended_run(folder: Path, payloads: tuple[bytes, ...]) -> RecordedPair:
    """One message arrives, with losses, repeats, deaths and a lost journal on its way."""
    run = RecordedPair(folder, *payloads)
    run.steps(30, {3: "repeated", 9: "offer lost", 20: "plant dies", 25: "controller dies"})
    run.step("plant forgets")
    run.until_received(1)
    run.steps(12, {8: "offer lost"})
    run.stop()
    manifest = {"wyner": "0", **run.scenario.identity()}
    write_atomically(folder / MANIFEST, json.dumps(manifest).encode())
    messages = len(read_lines(folder / CAPTURE)) - 2
    status = {"t_ns": 0, "first_part": 0, "captured": messages, "dropped": 0}
    write_atomically(folder / TAP_STATUS, json.dumps(status).encode())
    return run
