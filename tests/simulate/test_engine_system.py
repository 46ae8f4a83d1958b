"""The live services' run is the engine's, bit for bit."""

import base64
from pathlib import Path

import pytest
from pydantic_core import to_json

from runtime.run_folder import CONTROLLER_TRACE, PLANT_TRACE
from tests.support.programs import wyner
from tests.support.recorded_pair import law_of
from tests.support.size import size
from tests.support.traces import events_of
from wyner.simulate.engine import simulate_runs, transfer

TEXT = "Meet me where the river bends, at the second lamp after the bridge."


def up(folder: Path, *options: str) -> None:
    """The three services as processes over Zenoh on loopback."""
    more = ("--eavesdropper", "nearest-centre", "--run-dir", str(folder), *options)
    done = wyner("up", "--pace", "fast", *more, timeout=None)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
@pytest.mark.integration
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("name", "steps", "seed", "text"),
    [
        # Under the paper's own law the candidates coincide after ten steps: fewer are enough.
        ("paper", size(200, 10_000), 2, TEXT),
        ("sustained", size(800, 20_000), 2, size(TEXT[:12], 6 * TEXT)),
        ("quadruple-tank", size(500, 20_000), 2, size(TEXT[:5], 6 * TEXT)),
        ("packed", size(600, 1000), 21, size(TEXT[:40], TEXT)),
    ],
)
def test_live_services_and_engine_are_one_system(
    name: str, steps: int, seed: int, text: str, tmp_path: Path
) -> None:
    said = ("--scenario", name, "--message", text, "--seed", str(seed), "--steps", str(steps))
    up(tmp_path, *said)
    runs = simulate_runs(*law_of(name), seed=seed, runs=range(1), steps=steps, record=True)
    t = transfer(runs, payloads=[text.encode()])
    assert runs.x is not None
    assert runs.candidates is not None
    assert runs.gauges is not None
    for side, trace in (("plant", PLANT_TRACE), ("controller", CONTROLLER_TRACE)):
        made = events_of(tmp_path / trace, "transition")
        # the controller may lack the last: the plant waits a second for its report to be heard
        assert steps - (side == "controller") <= len(made) <= steps
        for j, event in enumerate(made):
            candidates, coin = runs.candidates[j, :, :, 0].tolist(), int(runs.coin[j, 0])
            expected = {
                "j": j,
                "k": j,
                "x": runs.x[j, :, 0].tolist(),
                "candidates": candidates,
                "cipher": int(t.cipher[j, 0]),
                "x_next": runs.x[j + 1, :, 0].tolist(),
                "gauges": runs.gauges[j, :, 0].tolist(),
                "symbol": int(t.agreed[j, 0]),
                "key": int(t.pad[j, 0]),
                "message_symbol": int(t.message_symbol[j, 0]),
                "p": int(t.p[j, 0]),
            }
            if side == "plant":
                expected |= {"coin": coin, "u": candidates[coin]}
            # as text, so that a zero of the other sign is another number
            assert to_json({name: event[name] for name in expected}) == to_json(expected)
    for trace, kind in ((PLANT_TRACE, "recovered"), (CONTROLLER_TRACE, "delivered")):
        arrived = [base64.b64decode(e["payload"]) for e in events_of(tmp_path / trace, kind)]
        assert arrived == ([] if name == "paper" else [text.encode()])
