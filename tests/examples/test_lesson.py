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


def test_what_a_solution_imports_is_named_before_it() -> None:
    """A student cannot find a class of the project that the exercise does not name."""
    text = LESSON.read_text(encoding="utf-8")
    for solution in re.finditer(r"<summary>Solution</summary>.*?</details>", text, re.DOTALL):
        exercise = text[: solution.start()].rpartition("## Exercise")[2]
        given = exercise + text.partition("## Exercise 1")[0]
        for names in re.findall(r"^from \S+ import (.*)$", solution[0], re.MULTILINE):
            for name in names.split(", "):
                assert re.search(rf"\b{name}\b", given), name
