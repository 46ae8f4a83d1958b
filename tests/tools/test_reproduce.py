"""The page for reviewers is run: what differs from it is told."""

from pathlib import Path

import pytest

from tools.reproduce import PAGE, ReviewRow, chosen_of, differs, main, rows, same_rows

TOLD = "python -c 'print(\"20 of\\n 20 messages\")'"


def row(
    command: str, expected: str = "pass", minutes: float = 0.1, tolerance: str = ""
) -> ReviewRow:
    return ReviewRow("a claim", command, minutes, expected, tolerance)


def test_every_row_of_the_page_can_be_run() -> None:
    text = PAGE.read_text(encoding="utf-8")
    found = rows(text)
    assert len(found) == sum(line.startswith("| ") for line in text.splitlines()) - 6
    assert all(row.printed or row.shipped or row.minutes for row in found)
    measured = {"attacks.csv", "network.csv", "schemes.csv", "stochastic.csv", "yardstick.csv"}
    assert {row.shipped for row in found} == {"", *measured}


@pytest.mark.parametrize(
    ("command", "expected", "why"),
    [
        (TOLD, "`20 of 20 messages`", ""),
        (TOLD, "`20 of 20 messages`, `none`", "did not print none"),
        ("python -c 'raise SystemExit(\"a reason\")'", "pass", "ended with code 1: a reason"),
        ("python -c ''", "[these rows](data/network.csv)", "network.csv is not as docs/data"),
    ],
)
def test_a_row_holds_when_all_is_as_expected(command: str, expected: str, why: str) -> None:
    said = differs(row(command, expected))
    assert why in said
    assert bool(said) == bool(why)


@pytest.mark.parametrize(
    ("ratio", "why"),
    [("85.5", ""), ("49", "ratio: got 49, expected at least 50"), ("null", "ratio: got None")],
)
def test_a_benchmarks_figure_is_at_least_what_its_tolerance_says(ratio: str, why: str) -> None:
    command = f"""python -c 'print("bench ...\\n{{\\"ratio\\": {ratio}}}")'"""
    said = differs(row(command, tolerance="ratio at least 50, idle machine"))
    assert why in said
    assert bool(said) == bool(why)


def test_every_benchmark_of_the_page_has_a_tolerance_that_is_compared() -> None:
    benchmarks = [r for r in rows(PAGE.read_text(encoding="utf-8")) if "bench" in r.command]
    assert len(benchmarks) == 3
    assert all(r.least is not None and r.command.endswith("--json") for r in benchmarks)


def test_a_row_that_does_not_end_is_given_up() -> None:
    assert "not done" in differs(row("python -c 'import time; time.sleep(60)'", minutes=1e-3))


@pytest.mark.parametrize(
    ("made", "same"),
    [
        ("version,rate\n1.1,0.25000000000001\n", True),
        ("version,rate\n1.0,0.26\n", False),
        ("version,rate\n1.0,none\n", False),
        ("version,rate\n1.0,0.25\n1.0,0.25\n", False),
        ("version,share\n1.0,0.25\n", False),
    ],
)
def test_rows_are_compared_without_the_version_of_the_code(
    made: str, same: bool, tmp_path: Path
) -> None:
    (tmp_path / "made.csv").write_text(made)
    (tmp_path / "shipped.csv").write_text("version,rate\n1.0,0.25\n")
    assert same_rows(tmp_path / "made.csv", tmp_path / "shipped.csv") == same


@pytest.mark.long
def test_the_short_rows_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--only", "examples/paper_scheme.py"]) == 0
    assert capsys.readouterr().out.endswith(
        f"1 of 1 rows hold; {len(rows(PAGE.read_text())) - 1} not run\n"
    )


def test_a_row_that_looks_at_a_run_comes_with_the_row_that_makes_it() -> None:
    """Its check takes less time than the run, and is left out where the run takes too long."""
    other, run = row("wyner other"), row("wyner up --run-dir build/one", minutes=0.3)
    check = row("wyner check build/one")
    page = [other, run, check]
    assert chosen_of(page, 1.0, "check") == [run, check]
    assert chosen_of(page, 0.1, "") == [other]
    assert chosen_of(page, 1.0, "") == page
