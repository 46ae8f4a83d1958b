"""The pages stay short: a limit on all of them together, and one on the first."""

import pytest

from tools.words import LIMIT, PAGES_LIMIT, README_LIMIT, ROOT, counted, main, words


def test_the_pages_together_keep_their_limit() -> None:
    assert sum(counted().values()) <= LIMIT, "run: python -m tools.words"


def test_there_are_twelve_pages() -> None:
    written = [name for name in counted() if name.startswith("docs/")]
    assert len(set(written) - {"docs/index.md"}) <= PAGES_LIMIT


def test_the_first_page_is_short() -> None:
    assert counted()["README.md"] <= README_LIMIT


def test_every_written_page_is_counted() -> None:
    there = {page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md")}
    made = {"docs/scenario-reference.md", "docs/command-reference.md"}
    assert there - set(counted()) == made
    assert min(counted().values()) > 50


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("two words", 2),
        ("| a | b |\n|---|---|\n| 1 = x | - |\n", 4),
        ("before\n<!-- generated: it -->\nmade by code\n<!-- end -->\nafter", 2),
        ("before\n<!-- begin it -->\nmade of data\n<!-- end it -->\nafter", 2),
        ("```sh\nwyner up\n```\n", 3),
    ],
)
def test_what_counts_as_a_word(text: str, expected: int) -> None:
    assert words(text) == expected


def test_the_counts_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main() == 0
    assert capsys.readouterr().out.splitlines()[0].endswith("README.md")
    assert main(["--all"]) == 2
    assert capsys.readouterr().err.startswith("usage: ")
