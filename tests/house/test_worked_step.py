"""The worked step: the numbers on the page are those of the run that it names."""

from tools.worked_step import worked


def test_the_step_is_what_the_page_says_of_it() -> None:
    step = worked()
    inside = [g <= 1 for g in step.agreed.verdict.gauges]
    assert inside.index(True) == step.agreed.symbol == step.coin
    assert inside.count(True) == 1
    assert max(step.agreed.verdict.gauges) <= step.scenario.secrecy.alpha
    nearest = min(range(2), key=step.agreed.verdict.gauges.__getitem__)
    assert nearest == step.agreed.symbol
    assert (step.carried.cipher - step.agreed.symbol) % 2 == step.carried.message_symbol
