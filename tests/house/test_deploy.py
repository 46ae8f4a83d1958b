"""What deployment rests on: each unit and container is started with options that are there."""

import re
import shlex

import pytest

from tests.support.programs import ROOT
from wyner.cli.main import build_parser, commands

UNITS = sorted((ROOT / "deploy" / "systemd").glob("*.service"))


def is_understood(words: list[str]) -> None:
    """Where a command is renamed, a service would else end with its first line."""
    assert words[0] in commands(), words
    build_parser(words[0]).parse_args(words)


def test_a_unit_starts_its_service() -> None:
    assert len(UNITS) > 2
    for unit in UNITS:
        text = unit.read_text(encoding="utf-8")
        (start,) = re.findall(r"^ExecStart=\S+ (.*)$", text, re.MULTILINE)
        assert unit.name == f"wyner-{start.split()[0]}.service"
        is_understood(shlex.split(start.replace("${WYNER_PACE}", "fast")))
        assert "RestartPreventExitStatus=2" in text


def test_a_container_starts_its_service() -> None:
    yaml = pytest.importorskip("yaml")
    text = (ROOT / "compose.yaml").read_text(encoding="utf-8")
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)
    services = yaml.safe_load(re.sub(r"\$\{\w+\}", "1", text))["services"]
    looked = 0
    for service in services.values():
        for said in (service.get("command"), service.get("healthcheck", {}).get("test")):
            words = [str(word) for word in said or ()]
            if words[:2] == ["CMD", "wyner"]:
                del words[:2]
            if not words or words[0] in ("CMD", "-c") or service.get("entrypoint"):
                continue
            is_understood(words)
            looked += 1
    assert looked > 12
