"""The walls between the rooms: who may import whom, and what is loaded when."""

import ast
import json
import re
from functools import cache
from pathlib import Path

import pytest

from tests.support.programs import ROOT, python

SERVICES = ("controller_service", "plant_service", "tap_service", "attacker_service")
ROOMS = (*SERVICES, "protocol", "runtime", "wyner", "benchmarks", "tools")

MODULES = [
    path
    for room in ROOMS
    for path in sorted((ROOT / room).rglob("*.py"))
    if "__pycache__" not in path.parts
]


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name for name in map(name_of, MODULES) if "." in name}


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Every module that a file names, in an import wherever it stands or in a string."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and node.value in NAMES:
            found.add(str(node.value))  # to be imported when it is needed
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def rooms_of(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports_of(path)} & set(ROOMS)


@cache
def loaded_by(*modules: str) -> frozenset[str]:
    """What a fresh interpreter has loaded after importing ``modules``."""
    code = (
        "import importlib, json, sys\n"
        "for name in json.loads(sys.argv[1]): importlib.import_module(name)\n"
        "print(json.dumps(sorted(sys.modules)))"
    )
    done = python("-c", code, json.dumps(modules))
    assert done.returncode == 0, done.stderr
    return frozenset(json.loads(done.stdout))


def inside(room: str) -> list[Path]:
    return [p for p in MODULES if p.relative_to(ROOT).parts[0] == room and p.stem != "__main__"]


MAY_IMPORT = {
    "protocol": set(),
    "runtime": {"protocol"},
    "controller_service": {"protocol", "runtime"},
    "tap_service": {"protocol", "runtime"},
    "attacker_service": {"protocol", "runtime", "tap_service"},  # it knows what Eve knows
    "plant_service": {"protocol", "runtime", "attacker_service"},
    "wyner": {"protocol", "runtime", *SERVICES},
    "wyner/dashboard": {"protocol", "runtime", "wyner"},
}


# --- rooms ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_imports_what_it_may(room: str) -> None:
    paths = [p for p in MODULES if p.is_relative_to(ROOT / room) and p.stem != "__main__"]
    assert len(paths) > 3
    for path in paths:
        assert rooms_of(path) <= MAY_IMPORT[room] | {room}, name_of(path)


def test_the_plant_loads_no_attack_where_there_is_none() -> None:
    loaded = loaded_by(*(name_of(path) for path in inside("plant_service")))
    assert not {n for n in loaded if n.startswith(("attacker_service", "tap_service"))}


def test_the_second_opinion_shares_nothing_with_what_it_judges() -> None:
    """What a check is to find wrong in the protocol, it may not ask the protocol."""
    path = ROOT / "wyner" / "runs" / "check" / "paper.py"
    assert not rooms_of(path)
    assert {name.split(".")[0] for name in imports_of(path)} == {"typing", "numpy"}


SHELL = {
    "asyncio", "ctypes", "fcntl", "io", "logging", "mmap", "multiprocessing", "os", "pathlib",
    "queue", "resource", "select", "selectors", "shutil", "signal", "socket", "sqlite3",
    "subprocess", "tempfile", "threading", "time", "datetime", "zenoh", "_signal", "secrets",
}  # fmt: skip
"""Threads, processes, sockets, files, clocks, chance: what the protocol has none of."""


def test_the_protocol_is_pure() -> None:
    """Time, randomness and what was heard are arguments; what is to be done is a value."""
    finders = {"protocol.plugins"}  # reads a user's own scheme, FILE.py:Name
    for path in inside("protocol"):
        if name_of(path) not in finders:
            roots = {name.split(".")[0] for name in imports_of(path)}
            assert roots.isdisjoint(SHELL), (name_of(path), roots & SHELL)
            calls = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call)]
            opened = [n for n in calls if isinstance(n.func, ast.Name) and n.func.id == "open"]
            assert not opened, name_of(path)
            drawn = [ast.unparse(n) for n in calls if DRAWS.fullmatch(ast.unparse(n))]
            assert not drawn, (name_of(path), drawn)


DRAWS = re.compile(
    r"(np\.random\.|random\.)?(default_rng|SeedSequence|Random|SystemRandom|PCG64)\(\)"
    r"|random\.(?!Random\().*|(uuid\.)?uuid[14]\(.*\)",
    re.DOTALL,
)
"""Calls that ask the operating system for randomness, or a generator that everybody shares."""


def test_the_rooms_of_the_protocol_stand_on_one_another() -> None:
    """Each imports those before it; what stands in no room is below all, or of the rooms named."""
    order = ("schemes", "secret", "defence", "messages", "scenario", "link")
    allowed = {room: set(order[:place]) for place, room in enumerate(order)}
    allowed |= {"knowledge": {"secret"}, "topics": {"messages"}, "gilbert_elliott": {"secret"}}
    seen = set()
    for path in inside("protocol"):
        room = path.relative_to(ROOT / "protocol").parts[0].removesuffix(".py")
        others = {name.split(".")[1] for name in imports_of(path) if name.startswith("protocol.")}
        assert others & set(order) - {room} <= allowed.get(room, set()), name_of(path)
        seen.add(room)
    assert seen > set(order)


def test_starting_the_command_loads_nothing_heavy() -> None:
    heavy = {"zenoh", "numpy", "scipy", "rich", "matplotlib", "osqp", "daqp"}
    assert loaded_by("wyner.cli.main").isdisjoint(heavy | {"pydantic"})
    commands = [name_of(path) for path in (ROOT / "wyner" / "cli").glob("[a-z]*.py")]
    assert len(commands) > 8
    assert loaded_by(*commands).isdisjoint(heavy)


# --- the tap --------------------------------------------------------------------------------------

SECRETS = {
    "protocol.scenario",  # D_c and alpha
    "protocol.link.records",  # keys and automata's states
    "protocol.link.session",
    "controller_service.core",
    "plant_service.core",
    "runtime.journal",  # both, and the message
    "protocol.streams",  # the coins
}
"""What holds alpha, D_c, coins, keys, journals or the truth. Schemes are algorithms, and public."""


def test_the_tap_loads_nothing_that_knows_a_secret() -> None:
    names = [name_of(path) for path in inside("tap_service")]
    assert {"tap_service.service", "tap_service.eavesdroppers.list_decoder"} <= set(names)
    loaded = loaded_by(*names)
    assert loaded.isdisjoint(SECRETS)
    assert {name.split(".")[0] for name in loaded}.isdisjoint(
        set(ROOMS) - {"protocol", "runtime", "tap_service"}
    )
    assert "protocol.schemes.base" in loaded
