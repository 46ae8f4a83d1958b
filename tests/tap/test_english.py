"""How likely each next byte is to one who expects English, and where the counts are kept."""

import dataclasses
import lzma
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from protocol.scenario import Scenario
from runtime.cache_folder import cache_folder
from studies.secrecy.runs import SENTENCES as SHORT
from studies.secrecy.sentences import SENTENCES
from tap_service.eavesdroppers.text import Text
from tap_service.inference import english as module
from tap_service.inference.english import (
    TEXT,
    AnyBytes,
    Contexts,
    English,
    Level,
    english,
    log2_probability,
)


def test_probabilities_of_the_next_byte_sum_to_one() -> None:
    at = Contexts.start(2)
    for byte in b"The quick brown fox's 3 jumps.":
        rows, which = english().next(at)
        np.testing.assert_allclose(rows[which].sum(axis=1), 1.0)
        at = at.after(np.array([byte, 200]))
    assert AnyBytes().next(at)[0].sum() == pytest.approx(1.0)


def test_english_is_likelier_than_noise_and_knows_no_message_of_the_studies() -> None:
    bits = [-log2_probability(english(), s.encode()) / len(s) for s in SENTENCES]
    assert np.mean(bits) < 3.2
    assert -log2_probability(english(), b"xq zvw jjk qpf") / 14 > 5
    text = lzma.decompress(TEXT.read_bytes()).decode().lower()
    assert [s for s in (*SENTENCES, *SHORT) if s.lower().rstrip(".") in text] == []


def test_a_sentence_begins_as_sentences_do_and_goes_on_as_words_follow_others() -> None:
    def bits(text: bytes) -> float:
        return -log2_probability(english(), text)

    assert bits(b"The") < bits(b"the")
    assert bits(b"It is so. The end") - bits(b"It is so. the end") < -2
    assert bits(b"He went to the hospital") < bits(b"He went to of hospital") - 4


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache folder of the test's own, read as a new process would."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    english.cache_clear()
    yield tmp_path / "wyner" / "english"
    english.cache_clear()


def columns(model: English) -> list[np.ndarray]:
    levels = (*model.orders, model.listed, model.listed_pair, model.word, model.pair)
    return [getattr(level, f.name) for level in levels for f in dataclasses.fields(Level)]


def test_what_was_counted_is_kept_for_the_next_process_in_the_place_of_an_older_one(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty_cache.mkdir(parents=True)
    (empty_cache / "older.npz").touch()
    counted = english()
    assert [path.suffix for path in empty_cache.iterdir()] == [".npz"]
    assert not (empty_cache / "older.npz").exists()
    english.cache_clear()
    monkeypatch.delattr(module, "lzma")  # nothing is counted again
    kept = english()
    assert kept is not counted
    for one, other in zip(columns(counted), columns(kept), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(counted.single, kept.single)


def test_what_is_kept_and_damaged_is_counted_again(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = english()
    (path,) = empty_cache.iterdir()
    whole = path.read_bytes()
    middle = len(whole) // 2
    changed = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    monkeypatch.setattr(English, "counted", lambda *_: model)
    for damaged in (b"", whole[:middle], changed, b"no archive at all"):
        path.write_bytes(damaged)
        english.cache_clear()
        assert english() is model
        assert path.read_bytes() == whole


def test_where_nothing_can_be_kept_it_is_counted(tmp_path: Path, empty_cache: Path) -> None:
    (tmp_path / "wyner").write_text("in the way")
    assert log2_probability(english(), b"It is so.") < 0
    assert not empty_cache.exists()


def test_who_has_no_home_is_given_a_folder_that_cannot_be_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(OSError, match="Not a directory"):
        cache_folder("english").mkdir(parents=True)


def test_who_names_her_waits_for_no_model(sustained: Scenario, empty_cache: Path) -> None:
    Text(sustained.knowledge())
    assert not empty_cache.exists()
