"""The worked step: the numbers on the page are those of the run that it names."""

from pathlib import Path

from tools.worked_step import PAGE, PICTURE, draw, numbers, refreshed, worked


def test_page_and_picture_are_fresh(tmp_path: Path) -> None:
    step = worked()
    text = PAGE.read_text(encoding="utf-8")
    assert numbers(step) in text
    assert refreshed(text, step) == text, "run: python -m tools.worked_step --write"
    draw(step, tmp_path / "step.svg")
    assert (tmp_path / "step.svg").read_bytes() == PICTURE.read_bytes()


def test_the_step_is_what_the_page_says_of_it() -> None:
    step = worked()
    inside = [g <= 1 for g in step.agreed.verdict.gauges]
    assert inside.index(True) == step.agreed.symbol == step.coin
    assert inside.count(True) == 1
    assert max(step.agreed.verdict.gauges) <= step.scenario.secrecy.alpha
    nearest = min(range(2), key=step.agreed.verdict.gauges.__getitem__)
    assert nearest == step.agreed.symbol
    assert (step.carried.cipher - step.agreed.symbol) % 2 == step.carried.message_symbol
