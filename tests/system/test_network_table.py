"""A network's table live: it takes the very steps that a simulation says."""

from pathlib import Path
from typing import Final

import pytest

from runtime.run_folder import PLANT_TRACE
from runtime.scenario_file import load_scenario
from tests.support.scenarios import text_of
from tests.support.size import size
from tests.support.traces import events_of
from wyner.cli.main import main
from wyner.simulate.missed import missed_steps

pytestmark = [pytest.mark.slow, pytest.mark.integration]

BURSTS: Final = "loss = 0.05\nloss_bad = 0.9\nto_bad = 0.05\nto_good = 0.3\n"
LATE: Final = 'delay = "gamma"\ndelay_s = 0.04\njitter_s = 0.04\n'

TABLES: Final = {
    "losses": ("loss = 0.4\n", "loss = 0.4\n"),
    "bursts": ("", BURSTS),
    "late": (LATE, LATE),
}
"""Each table's two directions, to the controller and to the plant, as in a scenario's file."""

STEPS: Final = 150
SEED: Final = 4


@pytest.mark.long
@pytest.mark.parametrize("name", size(["bursts", "late"], [*TABLES]))
def test_a_live_loop_misses_every_step_that_the_table_takes(name: str, tmp_path: Path) -> None:
    """At the plant's own pace. A late machine may miss others, and is not counted.

    So what the table takes of a live run is what it takes of a simulated one, whose share is held
    to the one computed (`test_the_share_computed_is_the_share_counted`).
    """
    up, down = TABLES[name]
    text = text_of("sustained")
    file, run_dir = tmp_path / f"{name}.toml", tmp_path / "run"
    file.write_text(f"{text}\n[network.to_controller]\n{up}\n[network.to_plant]\n{down}")
    run = ["up", "--scenario", str(file), "--run-dir", str(run_dir)]
    assert main([*run, "--steps", str(STEPS), "--seed", str(SEED)]) == 0
    made = {e["k"] for e in events_of(run_dir / PLANT_TRACE, "transition")}
    taken = missed_steps(load_scenario(file), seed=SEED, runs=range(1), steps=STEPS)
    assert taken is not None
    table = {k for k in range(STEPS) if taken[k, 0]}
    assert not table & made
    assert len(table) > 5
    assert len(made) > 30
