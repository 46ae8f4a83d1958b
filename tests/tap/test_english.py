"""How likely each next byte is by each kind of text that Eve expects, and by their mixture."""

import lzma
from itertools import islice

import numpy as np
import pytest

from studies.secrecy.kinds import messages
from studies.secrecy.runs import SENTENCES as SHORT
from studies.secrecy.sentences import SENTENCES
from tap_service.inference.english import TEXT
from tap_service.inference.expectation import ANY, UNKNOWN, expected
from tests.support.any_bytes import any_bytes


def bits(text: bytes) -> float:
    return -float(expected().weighed([text])[0][0])


@pytest.mark.parametrize("expectation", [expected, any_bytes])
def test_probabilities_of_the_next_byte_sum_to_one(expectation: object) -> None:
    assert callable(expectation)
    one = expectation()
    state = one.start(2)
    for byte in b"The quick brown fox's 3 jumps.":
        for last in (False, True):
            p, by_kind = one.next(state, np.full(2, last))
            np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-5)
        np.testing.assert_allclose(state.shares.sum(axis=1), 1.0)
        state = one.after(state, np.array([byte, 200]), by_kind, np.arange(2))


def test_english_is_likelier_than_noise_and_knows_no_message_of_the_studies() -> None:
    assert np.mean([bits(s.encode()) / len(s) for s in SENTENCES]) < 3.2
    assert bits(b"xq zvw jjk qpf") / 14 > 5
    text = lzma.decompress(TEXT.read_bytes()).decode().lower()
    assert [s for s in (*SENTENCES, *SHORT) if s.lower().rstrip(".") in text] == []


def test_a_sentence_begins_as_sentences_do_and_goes_on_as_words_follow_others() -> None:
    assert bits(b"The") < bits(b"the")
    assert bits(b"It is so. The end") - bits(b"It is so. the end") < -2
    assert bits(b"He went to the hospital") < bits(b"He went to of hospital") - 4


def test_capitals_cost_hardly_more_than_sentences() -> None:
    for sentence in SENTENCES[:5]:
        small, large = sentence.encode(), sentence.upper().encode()
        assert bits(large) < bits(small) + 0.15 * len(large)
        assert expected().weighed([large])[1] == ["English in capitals"]


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (b"Send the keys by noon.", "English sentences"),
        (b"Wir treffen uns morgen um acht vor dem Rathaus.", "German"),
        (b"Nous partirons demain avec les autres.", "French"),
        (b"40.7128, -74.0060", "digits and signs"),
        (b"9f86d081884c7d659a2feaa0c55ad015", "hexadecimal"),
        (b"q83vEjRWeJCrze8SNFZ4kKvN7xI0VniQ", "base64"),
        (bytes(range(128, 150)), ANY),
    ],
)
def test_a_text_tells_its_kind(text: bytes, kind: str) -> None:
    (total,), (found,) = expected().weighed([text])
    assert found == kind
    assert total > any_bytes().weighed([text])[0][0] - 5


def test_what_nobody_thought_of_costs_little_more_than_any_bytes() -> None:
    """Each kind has its share, so no message costs more than its share says."""
    for message in islice(messages(), 0, None, 4):
        assert bits(message.payload) < 8 * len(message.payload) + 5


def test_prose_goes_on_after_a_number() -> None:
    """A name or a number in a sentence does not make the rest of it any bytes."""
    before, after = b"Call me on +44 7700 900461 ", b"before the others have gone to bed."
    assert (bits(before + after) - bits(before)) / len(after) < 3.5


def test_texts_are_weighed_together_as_they_are_alone() -> None:
    texts = [b"Send the keys.", b"40.7128", b"Go", b"Wir treffen uns morgen."]
    together, kinds = expected().weighed(texts)
    alone = [expected().weighed([text]) for text in texts]
    assert together == pytest.approx([total[0] for total, _ in alone])
    assert kinds == [kind[0] for _, kind in alone]


def test_a_kind_is_named_where_it_is_likelier_than_all_others_together() -> None:
    one = expected()
    prior = np.array([kind.share for kind in one.kinds])
    assert one.named(prior / prior.sum()) == UNKNOWN
    assert one.named(np.eye(len(prior))[-1]) == ANY
    halves = [0.3 if kind.name == "hexadecimal" else 0.0 for kind in one.kinds]
    assert one.named(np.array(halves)) == "hexadecimal", "two kinds of one name"
