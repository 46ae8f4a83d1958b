"""What deployment rests on: units, options that are there."""

import re
from pathlib import Path

import pytest

from tests.support.programs import ROOT, wyner
from wyner.cli.main import build_parser, commands

UNITS = sorted((ROOT / "deploy" / "systemd").glob("*.service"))


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.stem)
def test_a_unit_starts_its_service_with_options_that_are_there(unit: Path) -> None:
    text = unit.read_text(encoding="utf-8")
    (start,) = re.findall(r"^ExecStart=\S+ (\S+) (.*)$", text, re.MULTILINE)
    name, options = start
    assert unit.name == f"wyner-{name}.service"
    done = wyner(name, "--help")
    for option in re.findall(r"--[a-z-]+", options):
        assert option in done.stdout
    assert "RestartPreventExitStatus=2" in text


def test_every_container_is_started_with_options_that_are_there() -> None:
    """Where a command is renamed, a container would else end with its first line."""
    yaml = pytest.importorskip("yaml")
    text = (ROOT / "compose.yaml").read_text(encoding="utf-8")
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)
    services = yaml.safe_load(re.sub(r"\$\{\w+\}", "1", text))["services"]
    looked = 0
    for name, service in services.items():
        for said in (service.get("command"), service.get("healthcheck", {}).get("test")):
            words = [str(word) for word in said or ()]
            if words[:2] == ["CMD", "wyner"]:
                del words[:2]
            if not words or words[0] in ("CMD", "-c") or service.get("entrypoint"):
                continue
            assert words[0] in commands(), (name, words)
            assert build_parser(words[0]).parse_args(words), name
            looked += 1
    assert looked > 12
