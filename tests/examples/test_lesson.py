"""The lesson's solutions run as they stand, their own assertions included."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LESSON = ROOT / "docs" / "tutorial.md"
SOLUTIONS = ROOT / "examples" / "lesson.py"


@pytest.mark.slow
def test_the_exercises_have_solutions_that_hold(capsys: pytest.CaptureFixture[str]) -> None:
    text = LESSON.read_text(encoding="utf-8")
    assert f"../examples/{SOLUTIONS.name}" in text
    assert text.count("<summary>Solution</summary>") == 3
    runpy.run_path(str(SOLUTIONS), run_name="__main__")
    told = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    assert capsys.readouterr().out == "".join(told), "the page prints what comes"
    assert len(told) == 3


@pytest.mark.slow
def test_the_page_gives_what_the_solutions_begin_with() -> None:
    (given,) = re.findall(r"```python\n(.*?)```", LESSON.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(given, "lesson", "exec"), {})
    imports, _, rest = given.partition("\n\nsystem")
    assert imports.startswith("import numpy as np")
    assert f"system{rest}" in SOLUTIONS.read_text(encoding="utf-8")


def test_what_a_solution_imports_is_named_on_the_page() -> None:
    """A student cannot find a class of the project that the exercise does not name."""
    text = LESSON.read_text(encoding="utf-8")
    exercises = re.sub(r"<summary>Solution</summary>.*?</details>", "", text, flags=re.DOTALL)
    found = re.findall(r"^from \S+ import (.*)$", SOLUTIONS.read_text(encoding="utf-8"), re.M)
    names = [name for line in found for name in line.split(", ")]
    assert len(names) == 5
    for name in names:
        assert re.search(rf"\b{name}\b", exercises), name
