"""The wall: nothing in the tap can look up D_c, the message, a key or the truth."""

import pkgutil
import subprocess
import sys

import pytest

import tap_service

FORBIDDEN = (
    "protocol.scenario",
    "protocol.link.session",
    "protocol.link.sender",
    "protocol.link.receiver",
    "protocol.runtime.journal",
    "protocol.schemes.switched",
    "protocol.streams",
    "controller_service",
    "plant_service",
    "wyner",
)

MODULES = sorted(
    m.name
    for m in pkgutil.walk_packages(tap_service.__path__, "tap_service.")
    if not m.name.endswith("__main__")
)


def loaded_by(module: str) -> set[str]:
    code = f"import sys, {module}; print('\\n'.join(sys.modules))"
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    return set(out.split())


def test_the_modules_are_all_there() -> None:
    assert {"tap_service.service", "tap_service.analysis", "tap_service.capture.recording"} <= set(
        MODULES
    )
    assert "tap_service.eavesdroppers.list_decoder" in MODULES


@pytest.mark.parametrize("module", MODULES)
def test_a_module_loads_nothing_that_knows(module: str) -> None:
    loaded = loaded_by(module)
    for name in FORBIDDEN:
        assert not {m for m in loaded if m == name or m.startswith(name + ".")}
    assert not {m for m in loaded if m == "zenoh" or m.startswith("zenoh.")}
