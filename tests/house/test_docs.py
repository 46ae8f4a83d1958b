"""The documents: diagrams fresh, every function and every test that they name is there."""

import ast
import csv
import importlib.util
import re
import shlex
from functools import cache
from pathlib import Path
from pydoc import locate

import pytest

from studies.registry import pages
from tools import command_reference, diagrams
from tools.scenario_reference import missing, page
from wyner.cli.main import build_parser, commands

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted((ROOT / "docs").glob("*.md"))
FIRST = ("README", "CONTRIBUTING", "CHANGELOG", "SECURITY")
LINKING = [*(ROOT / f"{name}.md" for name in FIRST), *DOCUMENTS]

with (ROOT / "docs" / "data" / "paper-to-code.csv").open(encoding="utf-8", newline="") as file:
    ROWS = [(row["paper"], row["function"], row["test"]) for row in csv.DictReader(file)]


@cache
def names_in(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_command_and_field_is_told_in_the_references() -> None:
    text = command_reference.page()
    for name in commands():
        assert f"### wyner {name}\n\n```text\nusage: wyner {name}" in text
    assert missing() == [], "a string below the field, in its class, is its line"
    assert "`[plant.disturbance]`" in page()


def test_the_generated_parts_are_fresh() -> None:
    assert diagrams.ROOMS
    for document, text in pages().items():
        assert document.read_text(encoding="utf-8") == text, "run: python -m tools.diagrams"


@pytest.mark.parametrize(("item", "function", "test"), ROWS, ids=[row[0] for row in ROWS])
def test_a_row_names_things_that_are_there(item: str, function: str, test: str) -> None:
    assert callable(locate(function)), item
    path, _, name = test.partition("::")
    assert name in names_in(ROOT / path), item


@cache
def anchors(page: Path) -> list[str]:
    """What a link may name after the page, as the site and the forges make it of the headings."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return [re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings]


@pytest.mark.parametrize("page", LINKING, ids=lambda path: path.stem)
def test_every_link_within_the_project_leads_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        target = page.parent / path if path else page
        assert target.exists(), link
        if anchor:
            assert anchors(target).count(anchor) == 1, link


def is_there(command: str) -> None:
    """A command of a page is one: its options parse, its modules, files and tests exist."""
    program, *words = shlex.split(command)
    if program == "wyner":
        build_parser(words[0]).parse_args(words)
        return
    assert program.rpartition("/")[2] in ("pytest", "python"), command
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1]) is not None, command
        return
    for path, _, name in (word.partition("::") for word in words):
        assert (ROOT / path).is_file(), command
        assert not name or name in names_in(ROOT / path), command


REPRODUCED = re.findall(
    r"^\|[^|]+\| `([^`]+)` \| [^|]+ \| [^|]+ \|[^|]*\|$",
    (ROOT / "docs" / "reproduce.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)


@pytest.mark.parametrize("command", REPRODUCED)
def test_a_command_of_the_page_for_reviewers_exists(command: str) -> None:
    is_there(command)


def typed(page: Path) -> list[str]:
    """The lines of a page's blocks of shell that begin with ``wyner``, without their comments."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^```(?:sh|console)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line.strip().removeprefix("$ ") for block in blocks for line in block.splitlines()]
    return [
        shlex.join(shlex.split(line, comments=True)) for line in lines if line.startswith("wyner ")
    ]


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")], ids=lambda path: path.stem
)
def test_what_a_page_tells_to_type_is_a_command(page: Path) -> None:
    for line in typed(page):
        is_there(line.partition(" '&'")[0].partition(" '|'")[0])
