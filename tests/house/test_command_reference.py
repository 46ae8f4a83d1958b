"""The page of the commands: fresh, and with every command."""

import sys

import pytest

from tools.command_reference import PAGE, PYTHON, help_of, main, page
from wyner.cli.main import commands


@pytest.mark.skipif(sys.version_info[:2] != PYTHON, reason="another Python sets help out otherwise")
def test_the_page_is_fresh() -> None:
    assert page() == PAGE.read_text(encoding="utf-8"), (
        "run: python -m tools.command_reference --write"
    )


def test_every_command_is_told() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in set(commands()) - {"bench"}:
        assert f"### wyner {name}\n" in text


def test_a_commands_help_is_whole() -> None:
    assert help_of("check").startswith("usage: wyner check")
    assert "--until-delivered" in help_of("up")


def test_a_wrong_option_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--draw"]) == 2
    assert capsys.readouterr().err.startswith("usage: ")
