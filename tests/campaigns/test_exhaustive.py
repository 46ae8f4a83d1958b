"""A short form of the exhaustive exploration, and rules that it finds broken."""

import random
from collections.abc import Callable
from typing import Any

import pytest

from controller_service import outgoing
from plant_service import stepper
from protocol.link import controller_session, distiller
from protocol.link.controller_session import TABLE
from protocol.link.distiller import Distiller
from protocol.link.session_table import Row
from protocol.messages import Offer
from protocol.secret.blocks import ExtractedBlock
from protocol.secret.nonces import Contribution, contribution_of
from runtime import perform
from tests.campaigns.end import End
from tests.campaigns.exhaustive import shortest
from tests.campaigns.loop import DIGITS, rules_of
from tests.campaigns.space import SIDES, Space
from tests.secret.test_keys_machine import WRONG as WRONG_STREAMS
from tests.support.broken import FIRST_COPY, broken, hasty
from tests.support.short_keys import short_keys
from tests.support.size import size

Patch = pytest.MonkeyPatch


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "acts"),
    size([("switched", True)], [("switched", False), ("switched", True), ("pipelined", False)]),
)
def test_nothing_breaks_within_a_few_events(scheme: str, acts: bool) -> None:
    starts = slice(size(-2, -6), -1)
    found = shortest(Space(scheme, keys=True, acts=acts), 3, 2, starts)
    assert not found.why, (found.why, found.path)
    assert len(found.seen) > size(750, 2000)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scheme", "acts", "coin"),
    size(
        [("pipelined", False, True), ("sealed", False, False)],
        [("switched", True, True), ("pipelined", False, True), ("sealed", True, True)],
    ),
)
def test_each_digit_serves_once_and_no_honest_step_alarms(
    scheme: str, acts: bool, coin: bool
) -> None:
    with short_keys(DIGITS):
        space = Space(scheme, keys=True, acts=acts, coin=coin)
        found = shortest(space, 3, 2, slice(size(-2, -4), -1))
    assert not found.why, (found.why, found.path)
    assert len(found.seen) > size(500, 1500)


@pytest.mark.long
@pytest.mark.parametrize("wrong", WRONG_STREAMS)
def test_a_wrong_stream_is_found(wrong: Callable[[Patch], None], monkeypatch: Patch) -> None:
    wrong(monkeypatch)
    with short_keys(DIGITS):
        found = shortest(Space("sealed", keys=True), 4, 1, slice(-4, -1))
    assert found.why
    assert len(found.path) <= 4


@pytest.mark.long
def test_a_step_that_is_looked_up_is_what_the_live_end_does() -> None:
    """Ends that are never packed come to the same states, and say the same."""
    space = Space("switched", keys=True)
    for seed in range(size(3, 6)):
        draw = random.Random(seed)
        ends = [End(side, rules_of("switched", keys=True)) for side in SIDES]
        states = [end.first for end in space.ends]
        sent: list[list[int]] = [list(end.greeting) for end in space.ends]
        for _ in range(150):
            side = draw.randrange(2)
            heard = sent[1 - side][-3:]
            all_that = space.ends[side].alone(states[side])
            if heard and draw.random() < 0.85:
                all_that = space.ends[side].hears(states[side], draw.choice(heard))
            if not all_that:
                continue
            outcome = draw.choice(all_that[: draw.choice((1, 1, 1, len(all_that)))])
            doing = space.ends[side].doings[outcome.label]
            message = space.messages[doing.message] if doing.message >= 0 else (None, b"")
            ends[side].do(doing, *message)
            assert tuple(map(space.messages.number, ends[side].out)) == outcome.said
            assert space.ends[side].find(ends[side]) == outcome.after
            states[side] = outcome.after
            sent[side] += outcome.said


def redecide(patch: Patch) -> None:
    """Rule 3: a step that is counted again decides its symbol again."""
    broken(patch, outgoing, " if decided is None else decided", "")


def apply_stale(patch: Patch) -> None:
    """Rule 5: an offer for a step gone by is applied."""
    right = 'return "current" if offer.k == self.state.link.k else "stale"'
    broken(patch, stepper, right, 'return "current"')


def publish_first(patch: Patch) -> None:
    """The shell publishes before it saves."""
    patch.setattr(perform, "perform", hasty)


def take_up_anything(patch: Patch) -> None:
    """Rule 6: a controller that lost its journal goes on in the plant's session."""
    for state in ("greeting", "serving", "elsewhere"):
        adopt = Row("adopt and serve", "serving")
        patch.setitem(TABLE, (state, "asked, session unknown"), adopt)


def end_on_a_late_hello(patch: Patch) -> None:
    """Rule 6: a hello that does not fit ends the session at once, whoever sent it."""
    for state in ("greeting", "serving"):
        ends = Row("end and step back", "greeting")
        patch.setitem(TABLE, (state, "asked, session does not fit"), ends)


def count_no_lives(patch: Patch) -> None:
    """Rule 6: a controller that was started again takes itself for the one before."""
    right = "return min(incarnation + 1, LARGEST_COUNT)"
    broken(patch, controller_session, right, "return incarnation")


def as_it_is(_: Patch) -> None:
    """Nothing is broken."""


@pytest.mark.wrong_on_purpose
@pytest.mark.long
@pytest.mark.parametrize(
    "rule",
    size([end_on_a_late_hello], [as_it_is, end_on_a_late_hello, count_no_lives]),
)
def test_a_hello_of_a_former_life_ends_nothing(
    rule: Callable[[Patch], None], monkeypatch: Patch
) -> None:
    rule(monkeypatch)
    found = shortest(Space("switched", keys=False), 5, 1, slice(-4, -3))
    assert bool(found.why) == (rule is not as_it_is)
    assert not found.why or len(found.path) == 5


def same_nonce_in_repeats(patch: Patch) -> None:
    """Rule 8: another copy of an offer carries the nonce of its copy 0."""
    patch.setattr(Distiller, "again", lambda _, offer: offer.model_copy(update={"copy_number": 1}))


def copy_0_after_a_death(patch: Patch) -> None:
    """Rule 8: a plant that was started again takes its next copy for the first."""
    broken(patch, stepper, *FIRST_COPY)


def count_any_copy(patch: Patch) -> None:
    """Rule 9: the plant counts an offer's nonce whichever copy it applied."""

    def wrong(*, applied_copy: int, measurement: str, **of: Any) -> Contribution:
        return contribution_of(applied_copy=0, measurement=measurement, **of)

    patch.setattr(distiller, "contribution_of", wrong)


def announce_at_once(patch: Patch) -> None:
    """Rule 10: a block is taken as confirmed once it is extracted here."""
    extracted = Distiller.extracted

    def wrong(self: Distiller, block: ExtractedBlock) -> None:
        extracted(self, block)
        said = {"block": block.number, "tag": block.tag}
        self.compare(Offer(session=block.session, k=0, candidates=(), cipher=0, **said))

    patch.setattr(Distiller, "extracted", wrong)


WRONG: dict[Callable[[Patch], None], bool] = {
    redecide: False,
    apply_stale: False,
    publish_first: False,
    take_up_anything: False,
    same_nonce_in_repeats: True,
    copy_0_after_a_death: True,
    count_any_copy: True,
    announce_at_once: True,
}


@pytest.mark.wrong_on_purpose
@pytest.mark.long
@pytest.mark.parametrize(("mutant", "keys"), WRONG.items())
def test_a_broken_rule_is_found_with_a_shortest_counterexample(
    mutant: Callable[[Patch], None], keys: bool, monkeypatch: Patch
) -> None:
    mutant(monkeypatch)
    found = shortest(Space("switched", keys=keys), 9, 1)
    assert found.why
    assert 0 < len(found.path) <= 9
