"""The paper: its table is that of the data, its citations are there, and it can be built."""

import re
from pathlib import Path

import pytest

from tools.paper import FOLDER, build, with_results

TEXT = (FOLDER / "paper.md").read_text(encoding="utf-8")


def test_the_table_is_that_of_the_data() -> None:
    assert with_results(TEXT) == TEXT, "run: make paper"


def test_every_citation_is_in_the_bibliography_and_the_other_way_round() -> None:
    cited = set(re.findall(r"@([a-z0-9]+)", TEXT.split("---", 2)[2]))
    listed = set(re.findall(r"^@\w+\{(\w+),", (FOLDER / "paper.bib").read_text(), re.MULTILINE))
    assert cited == listed


@pytest.mark.slow
def test_it_builds(tmp_path: Path) -> None:
    pytest.importorskip("pypandoc")
    pytest.importorskip("typst")
    build(FOLDER, tmp_path / "paper.pdf")
    assert (tmp_path / "paper.pdf").read_bytes().startswith(b"%PDF")
