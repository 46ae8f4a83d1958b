"""The library: its arrays are the engine's, its names are lazy, its errors are lines."""

import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wyner
from tap_service.eavesdroppers.nearest_centre import NearestCentre
from tests.support.programs import python
from wyner import (
    Belief,
    Eavesdropper,
    EavesdropperError,
    Guess,
    KnowledgeError,
    ScenarioError,
    Simulated,
    System,
    Transition,
    WynerError,
    build,
    design,
    eavesdrop,
    load,
    rate_against_alpha,
    run,
    scenario_names,
    vary,
)

MESSAGE = b"Hi"


@pytest.fixture(scope="module")
def system() -> System:
    return design("sustained")


@pytest.fixture(scope="module")
def runs(system: System) -> Simulated:
    return run(system, steps=900, runs=3, seed=5, message=MESSAGE)


def test_the_package_alone_loads_nothing_heavy() -> None:
    code = (
        "import sys, wyner; assert 'numpy' not in sys.modules; wyner.design; "
        "assert 'numpy' in sys.modules; assert 'matplotlib' not in sys.modules; "
        "assert 'pandas' not in sys.modules; assert 'zenoh' not in sys.modules"
    )
    assert python("-c", code).stderr == ""


def test_the_library_needs_nothing_that_linux_alone_has() -> None:
    """Without `fcntl` and `resource` the library runs, and a command says what it lacks."""
    code = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('fcntl', 'resource', 'termios', 'pty')))\n"
        "from wyner import design, eavesdrop, run\n"
        "eavesdrop(run(design('sustained'), steps=20, runs=1, seed=1))\n"
        "from wyner.cli.main import main\n"
        "sys.exit(main(['up']))\n"
    )
    done = python("-c", code)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("wyner: this system has no fcntl: the commands need Linux")


def test_every_name_is_there_and_has_words() -> None:
    from wyner import api

    for name in api.__all__:
        assert getattr(wyner, name) is getattr(api, name)
        assert getattr(api, name).__doc__
    rooms = {path.stem for path in Path(wyner.__file__).parent.iterdir()}
    assert rooms.isdisjoint(api.__all__), "a room loaded later would take the name's place"
    names: dict[str, object] = {}
    exec("from wyner import *", names)
    assert set(api.__all__) <= set(names)
    assert wyner.__version__ == version("wyner")
    with pytest.raises(AttributeError, match="module 'wyner' has no attribute 'desing'"):
        wyner.desing  # noqa: B018
    with pytest.raises(ImportError):
        from wyner import np  # noqa: F401


def test_shipped_scenarios_load_by_name_and_by_path() -> None:
    assert "paper" in scenario_names()
    from runtime.shipped import SCENARIOS

    assert load("paper") == load(SCENARIOS / "paper.toml")
    with pytest.raises(
        ScenarioError, match="nowhere: no such file, and no shipped scenario; shipped"
    ):
        load("nowhere")


def test_a_scenario_is_built_from_tables_and_wrong_ones_are_named() -> None:
    tables = load("double-integrator").model_dump(exclude_none=True)
    assert build(tables) == load("double-integrator")
    tables["secrecy"]["alpha"] = 0.5
    with pytest.raises(ScenarioError, match=r"^mine: secrecy.alpha: got 0.5, expected"):
        build(tables, "mine")


def test_fields_are_varied_by_their_path() -> None:
    s = load("sustained")
    assert vary(design("paper"), {"secrecy.alpha": 3.0}).secrecy.alpha == 3.0
    changed = vary(s, {"secrecy.alpha": 3.0, "control.costs.1.input": 2.0})
    assert changed.secrecy.alpha == 3.0
    assert changed.control.costs[1].input == 2.0
    assert vary(changed, {"secrecy.alpha": 8.0, "control.costs.1.input": 1.0}) == s
    for path in ("secrecy.alfa", "control.costs.9.input", "name.first"):
        with pytest.raises(ScenarioError, match=path.split(".")[0]):
            vary(s, {path: 1.0})


def test_arrays_fit_together(system: System, runs: Simulated) -> None:
    s = system.scenario
    assert (runs.count, runs.steps) == (3, 900)
    assert runs.x.shape == (3, 901, 2)
    assert runs.candidates.shape == (3, 900, 2, 1)
    assert runs.u.shape == (3, 900, 1)
    A, B = np.array(s.A), np.array(s.B)
    d = runs.x[:, 1:] - runs.x[:, :-1] @ A.T - runs.u @ B.T
    assert (np.abs(d) <= np.array(s.plant.disturbance.half_widths) + 1e-12).all()
    agreed = runs.key >= 0
    assert (runs.key[agreed] == runs.coin[agreed]).all()
    assert (runs.agreements == agreed.sum(axis=1)).all()
    assert runs.agreements.min() > 50
    inside = np.take_along_axis(runs.gauges, runs.coin[:, :, None].astype(int), axis=2)
    assert inside.max() <= 1.0


def test_the_message_arrives_and_its_rate_is_what_was_carried(runs: Simulated) -> None:
    assert all(MESSAGE in messages for messages in runs.messages)
    carried = (runs.message_symbol >= 0).sum()
    assert runs.rate.value == pytest.approx(carried / (3 * 900 * 0.1))
    assert not runs.rate.known  # three runs have no interval, and say so
    assert runs.rate.text().endswith(" (no interval)")
    (same,) = rate_against_alpha(runs, 8.0)
    assert same == runs.rate
    low, high = rate_against_alpha(runs, [1.5, 8.0])
    assert low.value < high.value


def test_a_frame_has_a_row_a_step(runs: Simulated) -> None:
    pytest.importorskip("pandas")
    frame = runs.frame()
    assert len(frame) == 2700
    one = runs.frame(1)
    assert (one["run"] == 1).all()
    assert (frame[frame["run"] == 1]["x_2"].to_numpy() == one["x_2"].to_numpy()).all()
    columns = "run k x_1 x_2 u_1 coin gauge_0 gauge_1 key cipher message_symbol"
    assert list(one.columns) == columns.split()
    assert (one["key"].to_numpy() == runs.key[1]).all()


class Stubborn(Eavesdropper):
    """Always guesses candidate 1."""

    name = "stubborn"

    def observe(self, transition: Transition) -> Guess:
        return Guess(transition.k, (0.0, 1.0), 1.0)

    def belief(self) -> Belief:
        return Belief()


def test_eavesdroppers_of_the_ladder_and_of_ones_own_are_scored(runs: Simulated) -> None:
    nearest, mine = eavesdrop(runs, ["nearest-centre", Stubborn])
    assert (nearest.name, mine.name) == ("nearest-centre", "stubborn")
    assert nearest.agreements == mine.agreements == runs.agreements.sum()
    assert nearest.keys.value > 0.95
    assert mine.right == (runs.key == 1).sum()
    assert mine.keys.value == pytest.approx(0.5, abs=0.06)
    assert not mine.keys.known
    assert nearest.delivered == sum(map(len, runs.messages)) > 0
    assert eavesdrop(runs, "nearest-centre") == [nearest]
    assert eavesdrop(runs, Stubborn)[0].right == mine.right


class Nameless(NearestCentre):
    name = None  # type: ignore[assignment]


class Unfinished(Eavesdropper):
    name = "unfinished"


class Oops(NearestCentre):
    name = "c"

    def observe(self, transition: Transition) -> Guess:
        if transition.k == 3:
            raise ValueError("oops")
        return super().observe(transition)


@pytest.mark.parametrize(
    ("who", "error", "told"),
    [
        ("nobody", KnowledgeError, "got 'nobody', expected set-membership"),
        (Nameless, KnowledgeError, "'Nameless': expected a class attribute name of 1 to 64"),
        (Unfinished, KnowledgeError, "expected the methods that it lacks: belief, observe"),
        (int, KnowledgeError, "got 'int', expected a class int that extends"),
        (Oops, EavesdropperError, "eavesdropper c: step 3: ValueError: oops"),
    ],
)
def test_an_eavesdropper_that_is_none_is_told_in_a_line(
    who: Any, error: type[Exception], told: str, runs: Simulated
) -> None:
    with pytest.raises(error, match=re.escape(told)):
        eavesdrop(runs, who)
    with pytest.raises(error, match=re.escape(told)):
        eavesdrop(runs, [who])


# --- figures --------------------------------------------------------------------------------------


def test_figures_are_drawn_on_the_users_axes(system: System, runs: Simulated) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from wyner import draw_agreement, draw_rate, draw_sets, draw_states

    axes = Figure().subplots(2, 2)
    draw_sets(system, axes[0, 0], [0, 1], runs)
    assert len(axes[0, 0].lines) == 2 + runs.count
    draw_agreement(runs, axes[0, 1])
    star = axes[0, 1].lines[-1]
    k = int(np.flatnonzero(runs.key[0] >= 0)[0])
    assert star.get_xydata().tolist() == [runs.x[0, k + 1].tolist()]
    draw_states(runs, axes[1, 0], run=1)
    assert axes[1, 0].lines[0].get_ydata().tolist() == runs.x[1, :, 0].tolist()
    draw_rate(runs, axes[1, 1], [2.0, 4.0, 8.0])
    assert axes[1, 1].lines[0].get_ydata()[-1] == pytest.approx(runs.rate.value)


# --- runs of the services -------------------------------------------------------------------------


def test_a_runs_folder_is_checked(tmp_path: Path) -> None:
    from tests.support.recorded_pair import RecordedPair

    small = RecordedPair(tmp_path / "run", b"hi")
    small.steps(40)
    small.stop()
    assert wyner.check(tmp_path / "run") == []
    (tmp_path / "run" / "plant" / "trace.jsonl").unlink()
    (tmp_path / "run" / "controller" / "trace.jsonl").write_bytes(b"nothing\n")
    assert {finding.rule for finding in wyner.check(tmp_path / "run")} >= {"whole"}
    with pytest.raises(FileNotFoundError, match="no run here"):
        wyner.check(tmp_path)


def test_wrong_input_is_a_value_error_with_a_line() -> None:
    """Each of these was an exception of a room of its own, from deep inside."""
    for wrong in (
        lambda: design("nosuch"),
        lambda: vary(load("sustained"), {"secrecy.alpa": 2}),
        lambda: eavesdrop(run(design("sustained"), steps=20, runs=1, seed=1), ["nearest"]),
    ):
        with pytest.raises(WynerError, match=r"expected|no such") as raised:
            wrong()
        assert isinstance(raised.value, ValueError)
        assert len(str(raised.value).splitlines()) == 1
