"""The lesson's code runs as it stands, its own assertions included, within a class's patience."""

import re
from pathlib import Path

import pytest

LESSON = Path(__file__).resolve().parents[2] / "docs" / "lesson.md"


@pytest.mark.slow
def test_the_exercises_have_solutions_that_hold(capsys: pytest.CaptureFixture[str]) -> None:
    text = LESSON.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 4
    assert text.count("<summary>Solution</summary>") == 3
    known: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "lesson", "exec"), known)
    out = capsys.readouterr().out
    told = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    assert out == "".join(told), "the page prints what comes"
    assert len(told) == 3
