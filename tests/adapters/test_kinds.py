"""What is particular to each kind of plant."""

import itertools
import math
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE

import pytest

from plant_service.adapters import PlantError
from plant_service.adapters.base import stepped
from plant_service.adapters.ode import Ode
from plant_service.adapters.registry import open_plant
from protocol.link.session import rules_of
from protocol.scenario import Scenario, parse_scenario
from runtime.scenario_file import load_scenario
from runtime.user_code import UserCodeError, load_attribute, made
from tests.adapters.plants import build_fmu
from tests.support.recorded_pair import RecordedPair


def test_runge_kutta_is_of_fourth_order() -> None:
    errors = []
    for substeps in (4, 8, 16):
        plant = Ode(lambda t, x, u: (-x[0] + u[0],), (2.0,), 1.0, substeps)
        plant.reset(None)
        (x,) = plant.step((1.0,), 1.0)
        errors.append(abs(x - (1.0 + math.exp(-1.0))))
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([4.0, 4.0], abs=0.25)


def test_dynamics_that_raise_say_where() -> None:
    plant = Ode(lambda t, x, u: (math.sqrt(-1.0),), (0.5,), 0.1)
    plant.reset(None)
    with pytest.raises(PlantError, match=r"the dynamics at x = \[0.5\]: math domain error"):
        plant.step((), 0.1)


CODE = """
class Tank:
    def reset(self, seed): return [1.0]
    def step(self, u, period_s): return [1.0]
class Half:
    def reset(self, seed): return [1.0]
class Needy:
    def __init__(self, level): pass
tank = Tank()
number = 3
"""


def test_code_is_found_beside_the_scenario_and_by_module_name(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(CODE)
    for name in ("mine.py:Tank", "mine.py:tank"):
        plant = stepped(made(load_attribute(name, tmp_path), name), name)
        assert plant.reset(None) == [1.0]
    assert load_attribute("math:pi", tmp_path) == math.pi


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mine.py", r"got 'mine.py', expected 'file.py:attribute' or 'module:attribute'"),
        (":Tank", "expected 'file.py:attribute'"),
        ("none.py:Tank", "none.py: no such file"),
        ("mine.py:Boat", "mine.py: has no 'Boat'"),
        ("no.such.module:x", "No module named 'no'"),
        ("bad.py:x", "bad.py: cannot be loaded: SyntaxError"),
        ("leaves.py:x", "leaves.py: cannot be loaded: SystemExit: 3"),
        ("mine.py:Half", r"has no method step, expected reset\(seed\) and step\(u, period_s\)"),
        ("mine.py:number", "has no method reset"),
        ("mine.py:Needy", "TypeError"),
    ],
)
def test_code_that_cannot_be_used_is_named(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "mine.py").write_text(CODE)
    (tmp_path / "bad.py").write_text("def")
    (tmp_path / "leaves.py").write_text("raise SystemExit(3)")
    with pytest.raises((PlantError, UserCodeError), match=says):
        stepped(made(load_attribute(name, tmp_path), name), name)


# --- FMUs -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    pytest.importorskip("fmpy")
    return build_fmu("line_fmi2", tmp_path_factory.mktemp("fmu"))


def test_an_fmu_of_another_hash_is_refused_before_it_is_opened(fmu: tuple[Path, str]) -> None:
    from plant_service.adapters.fmu import Fmu

    with pytest.raises(PlantError, match=f"its sha256 is {fmu[1]}, expected 00"):
        Fmu(fmu[0], "00", ["u"], ["place", "speed"])


@pytest.mark.parametrize(
    ("inputs", "outputs", "says"),
    [
        (["v"], ["place"], "has no variable 'v'; inputs and outputs: place, speed, u"),
        (["u"], ["height"], "has no variable 'height'"),
        (["place"], ["speed"], "'place' is a variable of causality output, expected input"),
    ],
)
def test_wrong_names_are_told_the_right_ones(
    fmu: tuple[Path, str], inputs: list[str], outputs: list[str], says: str
) -> None:
    from plant_service.adapters.fmu import Fmu

    with pytest.raises(PlantError, match=says):
        Fmu(*fmu, inputs, outputs)


def test_what_is_no_fmu_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    import hashlib

    from plant_service.adapters.fmu import Fmu

    path = tmp_path / "x.fmu"
    path.write_bytes(b"not a zip")
    with pytest.raises(PlantError, match=r"x\.fmu: .*zip"):
        Fmu(path, hashlib.sha256(b"not a zip").hexdigest(), ["u"], ["y"])
    with pytest.raises(PlantError, match="cannot be read: No such file"):
        Fmu(tmp_path / "y.fmu", "", ["u"], ["y"])


def test_what_a_killed_plant_left_of_an_fmu_goes_at_the_next_start(fmu: tuple[Path, str]) -> None:
    """And nothing of one that lives."""
    from plant_service.adapters.fmu import Fmu

    code = (
        "import pathlib, sys\n"
        "from plant_service.adapters.fmu import Fmu\n"
        "plant = Fmu(pathlib.Path(sys.argv[1]), sys.argv[2], ['u'], ['place', 'speed'])\n"
        "plant.reset(None)\n"
        "print(plant.folder, flush=True)\n"
        "sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", code, str(fmu[0]), fmu[1]]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, text=True) as other:
        assert other.stdout is not None
        left = Path(other.stdout.readline().strip())
        Fmu(*fmu, ["u"], ["place", "speed"]).close()
        assert any(left.iterdir()), "its process lives"
        other.kill()
        other.wait()
        assert any(left.iterdir())
    Fmu(*fmu, ["u"], ["place", "speed"]).close()
    assert not left.exists()


# --- Gymnasium ------------------------------------------------------------------------------------


def test_gymnasium_pendulum_is_read_and_set_in_full_precision() -> None:
    pytest.importorskip("gymnasium")
    from plant_service.adapters.gymnasium_env import make

    plant = make("Pendulum-v1", "state", (0.1, 0.0), 0.05)
    assert plant.reset(3) == (0.1, 0.0)
    angle, speed = plant.step((0.5,), 0.05)
    expected = (15.0 * math.sin(0.1) + 3.0 * 0.5) * 0.05
    assert speed == pytest.approx(expected, abs=1e-15)
    assert angle == pytest.approx(0.1 + expected * 0.05, abs=1e-15)
    plant.close()


ENVIRONMENTS = """
import gymnasium
import numpy as np

class Own(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (1,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.zeros(1)
        return self.x, {}

    def step(self, u):
        self.x = 0.9 * self.x + 0.1 * np.asarray(u)
        return self.x, 0.0, False, False, {}

class Discrete(Own):
    action_space = gymnasium.spaces.Discrete(2)

class Shared(Own):
    def step(self, u):
        self.x = 0.9 * self.x + 0.1 * np.asarray(u) + np.random.uniform(-0.01, 0.01, 1)
        return self.x, 0.0, False, False, {}

class Seedless(Own):
    def reset(self):
        self.x = np.zeros(1)
        return self.x, {}

class Bare(Own):
    def reset(self, *, seed=None, options=None):
        self.x = np.zeros(1)
        return self.x

class Four(Own):
    def step(self, u):
        return self.x, 0.0, False, {}

class Rows(Own):
    def reset(self, *, seed=None, options=None):
        return {"x": 1.0}, {}

for own in (Own, Discrete, Shared, Seedless, Bare, Four, Rows):
    gymnasium.register(f"Wyner{own.__name__}-v0", entry_point=own)
"""


def environment(folder: Path, name: str, inputs: str = "[1.0]") -> Scenario:
    (folder / "wyner_environments.py").write_text(ENVIRONMENTS)
    text = f"""
name = "own"
[plant]
kind = "gymnasium"
id = "wyner_environments:Wyner{name}-v0"
period_s = 0.1
operating_point = {{ state = [0.0], input = [0.0] }}
[plant.disturbance]
enters = "none"
[defender]
A = [[0.9]]
B = [[0.1]]
[defender.disturbance]
half_widths = [0.02]
[control]
law = "packed"
horizon = 5
inputs = {{ half_widths = {inputs} }}
[secrecy]
alpha = 8.0
candidates = 2
"""
    path = folder / "own.toml"
    path.write_text(text)
    return load_scenario(path)


@pytest.mark.parametrize(
    ("name", "inputs", "says"),
    [
        (
            "Discrete",
            "[1.0]",
            r"action space is Discrete\(2\), expected a Box of one dimension",
        ),
        (
            "Own",
            "[1.5]",
            "control.inputs: got input 1 from -1.5 to 1.5, expected it within -1 to 1, the "
            "environment's action space",
        ),
    ],
)
def test_an_environment_takes_every_input_of_the_scenario(
    name: str, inputs: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("gymnasium")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlantError, match=says) as raised:
        open_plant(environment(tmp_path, name, inputs), tmp_path)
    assert str(raised.value).count("\n") == 0
    open_plant(environment(tmp_path, "Own"), tmp_path).close()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Seedless", "reset takes no seed, expected Gymnasium's interface of version 0.26"),
        ("Bare", "reset returns no observation with its info"),
        ("Four", "step returns other than five values"),
        ("Rows", "expected a sequence of numbers"),
    ],
)
def test_an_old_interface_is_named_in_one_line(
    name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("gymnasium")
    monkeypatch.syspath_prepend(tmp_path)
    plant = open_plant(environment(tmp_path, name), tmp_path)
    with pytest.raises(PlantError, match=says) as raised:
        plant.start(1)
        plant.apply((0.5,))
        plant.sample()
    assert "\n" not in str(raised.value)
    plant.close()


def test_the_seed_reaches_an_environment_that_draws_from_the_shared_generators(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("gymnasium")
    monkeypatch.syspath_prepend(tmp_path)
    readings = []
    for seed in (5, 5, 6):
        plant = open_plant(environment(tmp_path, "Shared"), tmp_path)
        plant.start(seed)
        plant.apply((0.5,))
        readings.append(plant.sample())
        plant.close()
    assert readings[0] == readings[1] != readings[2]


def test_tables_of_free_names_make_a_live_plant(
    tmp_path: Path, fmu: tuple[Path, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`plant.arguments` and `plant.start`: the loop's rules are looked up by their scenario."""
    pytest.importorskip("gymnasium")
    more = '\n[plant.arguments]\ng = 10.0\nrender_mode = "rgb_array"\n'
    loop = RecordedPair(tmp_path / "run", name="gymnasium-pendulum", more=more)
    loop.run(lambda: loop.transitions >= 20)
    loop.stop()
    assert loop.wrong() == []
    monkeypatch.syspath_prepend(tmp_path)
    scenario = environment(tmp_path, "Own")
    given: dict[str, object] = dict(zip(("file", "sha256"), map(str, fmu), strict=True))
    given |= {"kind": "fmu", "inputs": ["u"], "outputs": ["place"]}
    data = scenario.model_dump(exclude_unset=True)
    del data["plant"]["id"]
    for start in ({"place": 3.0}, {"place": 3.0, "speed": 1.0}):
        data["plant"] |= given | {"start": start}
        told = parse_scenario(data, "own")
        assert hash(told) == hash(told.model_copy())
        assert rules_of(told).fingerprint == told.fingerprint()
        plant = open_plant(told)
        assert plant.start(None)[0] == 3.0
        plant.close()
