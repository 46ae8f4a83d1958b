"""The references that the site is built with: whole, and of the models and commands themselves."""

import tomllib
from pathlib import Path

import pytest

from protocol.scenario import LAWS, PLANTS, Scenario
from runtime.shipped import SCENARIOS
from tools import command_reference
from tools.scenario_reference import form_of, missing, page
from wyner.cli.main import commands


def test_every_command_is_told_with_its_options() -> None:
    text = command_reference.page()
    for name in commands():
        assert f"### wyner {name}\n\n```text\nusage: wyner {name}" in text
    assert "--until-delivered" in text


def test_every_field_says_what_it_is_for() -> None:
    assert missing() == [], "a string below the field, in its class, is its line"


def test_every_table_kind_and_law_is_told() -> None:
    text = page()
    for table in ("plant.disturbance", "defender", "control.regulator", "[control.costs]", "tap"):
        assert f"`[{table}]`" in text
    for kind in PLANTS:
        assert f'`[plant] of kind = "{kind}", besides`' in text
    assert set(LAWS) >= {"paper", "sustained", "packed"}


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_field_of_the_shipped_files_is_in_it(path: Path) -> None:
    text = page()

    def fields(table: dict[str, object]) -> set[str]:
        found = set(table)
        for value in table.values():
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, dict):
                    found |= fields(part)
        return found

    told = tomllib.loads(path.read_text(encoding="utf-8"))
    sets = {"half_widths", "H", "h"}
    assert all(f"| `{name}` |" in text for name in fields(told) - sets)


def test_forms_are_those_of_toml() -> None:
    fields = Scenario.model_fields
    assert form_of(tuple[tuple[float, ...], ...]) == "matrix"
    assert form_of(tuple[float, float]) == "list of 2 numbers"
    assert form_of(fields["name"].annotation, fields["name"]) == "text"
