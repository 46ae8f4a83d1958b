"""The reference of the scenario file: fresh, whole, and of the models that read it."""

import pytest

from protocol.scenario import LAWS, PLANTS, Scenario
from runtime.shipped import SCENARIOS
from tools.scenario_reference import PAGE, form_of, lines_of, main, missing, page


def test_the_page_is_fresh() -> None:
    assert page() == PAGE.read_text(encoding="utf-8"), (
        "run: python -m tools.scenario_reference --write"
    )


def test_every_field_says_what_it_is_for() -> None:
    assert missing() == [], "a string below the field, in its class, is its line"


def test_every_table_kind_and_law_is_told() -> None:
    text = page()
    for table in ("plant.disturbance", "defender", "control.regulator", "[control.costs]", "tap"):
        assert f"`[{table}]`" in text
    for kind in PLANTS:
        assert f'`[plant] of kind = "{kind}", besides`' in text
    assert all(name in Scenario.model_fields for name in lines_of(Scenario))
    assert set(LAWS) >= {"paper", "sustained", "packed"}


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_field_of_the_shipped_files_is_in_it(path: object) -> None:
    import tomllib

    text = page()

    def fields(table: dict[str, object]) -> set[str]:
        found = set(table)
        for value in table.values():
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, dict):
                    found |= fields(part)
        return found

    with open(str(path), "rb") as file:  # noqa: PTH123
        told = tomllib.load(file)
    sets = {"half_widths", "H", "h"}
    assert all(f"| `{name}` |" in text for name in fields(told) - sets)


def test_forms_are_those_of_toml() -> None:
    fields = Scenario.model_fields
    assert form_of(tuple[tuple[float, ...], ...]) == "matrix"
    assert form_of(tuple[float, float]) == "list of 2 numbers"
    assert form_of(fields["name"].annotation, fields["name"]) == "text"


def test_it_can_be_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert capsys.readouterr().out == page()
