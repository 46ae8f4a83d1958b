"""Scenario files: one line for each wrong field, fingerprints of what is shared, those we ship."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.scenario import Scenario, ScenarioError, parse_scenario
from runtime.scenario_file import load_scenario, scenario_of
from tests.support.scenarios import put, text_of

Table = dict[str, Any]


def paper() -> Table:
    return tomllib.loads(text_of("paper"))


def with_value(path: str, value: object) -> Table:
    """The paper's file with one field set, or without it."""
    data = paper()
    if path == "control.costs.0.next_state.1":
        data["control"]["costs"][0]["next_state"] = [1.0, 1.0]
    put(data, path, value)
    return data


def problems(data: Table) -> tuple[str, ...]:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(data, "mine.toml")
    return caught.value.problems


# --- wrong fields ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        ("name", "two words", "string should match pattern"),
        ("nmae", "typo", "no such field"),
        ("plant", None, "expected here, and not given"),
        ("plant.A", [[1.0, 0.1], [0.0]], "expected rows of one length"),
        ("plant.A", [], "expected at least one row"),
        ("plant.A", [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0]], "got shape (2, 3), expected (2, 2)"),
        ("plant.A", "identity", "expected a list"),
        ("plant.A", [[1.0, float("nan")], [0.0, 1.0]], "finite number"),
        ("plant.B", [[0.1]], "expected (2, 1)"),
        ("plant.period_s", 0, "greater than 0"),
        ("plant.period_s", "fast", "valid number"),
        ("plant.initial_state", [1.0], "got shape 1, expected 2"),
        ("plant.disturbance.kind", "cauchy", "expected 'uniform'"),
        ("plant.disturbance.half_widths", [0.1], "got shape 1, expected 2"),
        ("plant.disturbance.half_widths", [0.1, 0.13], "expected a box inside"),
        ("plant.disturbance.half_widths", [-0.1, 0.1], "greater than or equal to 0"),
        ("plant.disturbance.cycle_steps", 1, "greater than or equal to 2"),
        ("defender.A", [[1.0]], "got shape (1, 1), expected (2, 2)"),
        ("defender.disturbance", {"half_widths": [0.12, 0.0]}, "a small one, such as a thousandth"),
        ("defender.disturbance.half_widths", [0.12] * 3, "got shape 3, expected 2"),
        ("defender.disturbance", {"H": [[1.0, 0.0]]}, "expected half_widths = [...], or H"),
        ("defender.disturbance.H", [[1.0, 0.0]], "and not both"),
        (
            "control.law",
            "fastest",
            "expected paper, sustained, packed, or path/to/file.py:Name",
        ),
        ("control.horizon", 0, "greater than or equal to 1"),
        ("control.horizon", 2.5, "valid integer"),
        ("control.gain", None, "expected gain = [[...]] or a table regulator"),
        ("control.gain", [[1.0]], "got shape (1, 1), expected (1, 2)"),
        ("control.inputs.half_widths", [6.0, 6.0], "got shape 2, expected 1"),
        ("control.costs.0.next_state", [1.0], "got shape 1, expected 2"),
        ("control.costs.1.input", -1.0, "greater than or equal to 0"),
        ("control.costs.1.input", "much", "valid number"),
        ("control.costs.0.next_state.1", -1.0, "greater than or equal to 0"),
        ("control.costs", [{"input": 1.0}], "expected one for each of the 2 candidates"),
        ("secrecy.alpha", 0.9, "greater than or equal to 1"),
        ("secrecy.alpha", None, "expected here, and not given"),
        ("secrecy.candidates", 1, "greater than or equal to 2"),
        ("link.fallback", "panic", "expected 'hold', 'zero' or 'regulator'"),
        ("link.repeats_per_period", 0, "greater than or equal to 1"),
        ("tap.loss", 1.5, "less than or equal to 1"),
        ("plant.disturbance.cycle_steps", 10**400, "expected a number of at most 1e+150"),
        ("plant.A.0.1", -(10**4000), "expected a number of at most 1e+150"),
        ("control.costs.0.input", 1e151, "got 1e+151, expected a number of at most 1e+150"),
        ("secrecy.candidates", 10**151, "expected a number of at most 1e+150"),
        ("tap.view", "none", "expected 'both'"),
    ],
)
def test_a_wrong_field_is_one_line_with_its_path(path: str, value: object, expected: str) -> None:
    (line,) = problems(with_value(path, value))
    # what concerns a table as a whole is said of the table
    named = {"control.gain": "control" if value is None else path}.get(path, path)
    for table in ("defender.disturbance", "control.inputs"):
        named = table if path.startswith(f"{table}.") and "shape" in expected else named
    named = "defender.disturbance" if path == "defender.disturbance.H" else named
    assert line.startswith(f"mine.toml: {named}"), line
    assert expected in line
    assert "\n" not in line


def test_a_disturbance_that_may_leave_says_so() -> None:
    data = with_value("plant.disturbance.half_widths", [0.2, 0.2])
    data["plant"]["disturbance"]["may_leave_defender_set"] = True
    assert parse_scenario(data, "mine.toml").plant.disturbance.may_leave_defender_set
    gaussian = with_value("plant.disturbance", {"kind": "gaussian", "half_widths": [0.2, 0.2]})
    assert parse_scenario(gaussian, "mine.toml").plant.disturbance.kind == "gaussian"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"name = ", "not TOML"),
        (b"\xff\xfe", "not UTF-8 text"),
        (b"", "expected here, and not given"),
        (b"name = " + b"9" * 5000, "not TOML"),
        (b"name = " + b"[" * 3000 + b"]" * 3000, "not TOML"),
        (b"name = 0x" + b"f" * 5000, "name: got a longer one, expected a number of at most 1e+150"),
    ],
)
def test_a_file_that_is_no_scenario(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in caught.value.problems)
    assert expected in caught.value.problems[0]


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(tmp_path / "none.toml")
    assert caught.value.problems == (
        f"{tmp_path / 'none.toml'}: cannot be read: No such file or directory",
    )


# --- what is shared -------------------------------------------------------------------------------


def changed(path: str, value: object, also: Callable[[Table], None] | None = None) -> Scenario:
    data = with_value(path, value)
    if also is not None:
        also(data)
    return parse_scenario(data, "mine.toml")


SHARED: list[tuple[str, object]] = [
    ("plant.A", [[1.0, 0.0975], [0.0, 0.9513]]),
    ("plant.B", [[0.0246], [0.4878]]),
    ("plant.period_s", 0.2),
    ("defender.A", [[1.0, 0.0975], [0.0, 0.9511]]),
    ("defender.B", [[0.0247], [0.4877]]),
    ("defender.disturbance.half_widths", [0.12, 0.1200000001]),
    ("control.inputs.half_widths", [5.9]),
    ("secrecy.alpha", 8.000000000000002),
]
PRIVATE: list[tuple[str, object]] = [
    ("name", "mine"),
    ("description", "other words"),
    ("plant.initial_state", [0.0, 0.0]),
    ("plant.disturbance.half_widths", [0.05, 0.05]),
    ("plant.disturbance.kind", "corners"),
    ("control.law", "sustained"),
    ("control.horizon", 20),
    ("control.gain", [[-10.0, -2.0]]),
    ("link.fallback", "zero"),
    ("tap.loss", 0.5),
]


@pytest.mark.parametrize(("path", "value"), SHARED, ids=[path for path, _ in SHARED])
def test_the_fingerprint_changes_with_what_both_ends_share(path: str, value: object) -> None:
    assert changed(path, value).fingerprint() != parse_scenario(paper(), "").fingerprint()


@pytest.mark.parametrize(("path", "value"), PRIVATE, ids=[path for path, _ in PRIVATE])
def test_the_fingerprint_keeps_with_everything_else(path: str, value: object) -> None:
    assert changed(path, value).fingerprint() == parse_scenario(paper(), "").fingerprint()


@pytest.mark.parametrize(
    ("path", "value", "same"),
    [
        ("control.horizon", 20, False),
        ("control.gain", [[-10.0, -2.0]], False),
        ("control.inputs.half_widths", [5.0], False),
        ("defender.disturbance.half_widths", [0.11, 0.11], False),
        ("control.law", "sustained", True),
        ("secrecy.alpha", 2.0, True),
        ("plant.initial_state", [0.0, 0.0], True),
    ],
)
def test_a_design_is_kept_for_what_it_depends_on(path: str, value: object, same: bool) -> None:
    mine, papers = changed(path, value), parse_scenario(paper(), "")
    assert (mine.design_fingerprint() == papers.design_fingerprint()) == same


# --- what the eavesdropper is told ----------------------------------------------------------------


def test_the_eavesdropper_is_told_the_large_set_and_no_alpha() -> None:
    scenario = parse_scenario(paper(), "")
    told = scenario.knowledge()
    assert told.alpha is None
    assert told.disturbance_h == (0.96,) * 4
    assert "0.12" not in told.model_dump_json()
    assert scenario.oracle_knowledge().alpha == 8.0


# --- shipped --------------------------------------------------------------------------------------


def test_the_papers_constants() -> None:
    s = scenario_of("paper")
    assert s.plant.A == ((1.0, 0.0975), (0.0, 0.9512))
    assert s.plant.B == ((0.0246,), (0.4877,))
    assert s.plant.period_s == 0.1
    assert s.plant.disturbance.half_widths == (0.1, 0.1)  # (23)
    assert s.defender.disturbance.half_widths == (0.12, 0.12)  # (24)
    assert s.control.gain == ((-13.27, -2.26),)  # (25)
    assert s.control.horizon == 250
    assert s.control.inputs.half_widths == (6.0,)
    assert [(c.next_state, c.input) for c in s.control.costs] == [(1.0, 0.0), (0.0, 1.0)]


def test_keys_are_made_under_a_claim_that_is_stated() -> None:
    assert parse_scenario(paper(), "paper").keys is None
    data = paper()
    data["keys"] = {}
    keys = parse_scenario(data, "paper").keys
    assert keys is not None
    assert keys.schedule() is None
    assert "eps_E = 0: nothing is claimed" in (keys.refusal() or "")
    data["keys"] = {"eps_E": 0.3}
    keys = parse_scenario(data, "paper").keys
    assert keys is not None
    assert keys.refusal() is None
    schedule = keys.schedule()
    assert schedule is not None
    assert (schedule.first, schedule.largest) == (44, 256)


def test_parts_of_a_message_that_leaves_twice_are_not_claimed() -> None:
    """The half that she did not hear of one appearance she may hear of the other."""
    data = with_value("keys", {"eps_E": 0.3, "appearances": 2})
    assert parse_scenario(data, "paper").keys is not None
    data["keys"]["unheard_bits"] = 128
    with pytest.raises(ScenarioError, match="appearances = 2 beside unheard_bits, expected 1"):
        parse_scenario(data, "paper")


@pytest.mark.parametrize(
    "claim",
    [
        {"eps_E": 0.3},
        {"eps_E": 0.2},
        {"eps_E": 0.3, "eps_sec": 1e-9},
        {"eps_E": 0.3, "appearances": 2},
        {},
    ],
)
def test_the_claim_is_part_of_the_fingerprint(claim: Table) -> None:
    base = paper()
    base["keys"] = {"eps_E": 0.3, "directions": "offers"}
    other = paper()
    other["keys"] = claim
    prints = {parse_scenario(t, "t").fingerprint() for t in (paper(), base, other)}
    assert len(prints) == 3
