"""The paper: its table is that of the data, and it can be built."""

from pathlib import Path

import pytest

from tools.paper import FOLDER, build, with_results


def test_the_table_is_that_of_the_data() -> None:
    text = (FOLDER / "paper.md").read_text(encoding="utf-8")
    assert with_results(text) == text, "run: make paper"


@pytest.mark.slow
def test_it_builds(tmp_path: Path) -> None:
    pytest.importorskip("pypandoc")
    pytest.importorskip("typst")
    build(FOLDER, tmp_path / "paper.pdf")
    assert (tmp_path / "paper.pdf").read_bytes().startswith(b"%PDF")
