"""The check of sealed messages: what travelled, what was sealed, what was opened."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from protocol.messages import Sealed
from protocol.secret.records import BlockRow
from runtime.keys.sealed_book import SealedBook, SealedText
from runtime.keys.store import KeyStore
from runtime.run_folder import CONTROLLER_KEYS, PLANT_KEYS
from tests.runs.check.judged import evidence, judge
from tests.support.giving import sealed_by
from wyner.runs.check.base import Counter, Place
from wyner.runs.check.capture import CapturedMessage
from wyner.runs.check.evidence import Part
from wyner.runs.check.sealed import SealedOnce

TEXT = b"at nine"


@dataclass
class Run:
    """Two messages, sealed, opened, and on their way in the capture."""

    folder: Path
    m: SealedText
    n: SealedText


@pytest.fixture
def run(tmp_path: Path) -> Run:
    keys = [bytes([7 * i + 1]) * 32 for i in range(12)]
    stores = []
    for side, name in (("controller", CONTROLLER_KEYS), ("plant", PLANT_KEYS)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        store = KeyStore(tmp_path / name, side, create=True)  # type: ignore[arg-type]
        store.add(BlockRow("s", 0, 256, 256, 512, 13, 12, "stored", 1), keys, tag="t")
        store.confirm("s", 0)
        stores.append(store)
    sealing, opening = map(SealedBook, stores)
    texts = []
    for identifier in ("m", "n"):
        sealing.queue(identifier, TEXT)
        text = sealed_by(sealing, opening.store)
        assert text is not None
        assert opening.open(text)
        assert sealing.acknowledged(identifier)
        texts.append(text)
    for store in stores:
        store.close()
    return Run(tmp_path, *texts)


def seen(number: int, text: SealedText) -> CapturedMessage:
    raw = Sealed(id=text.identifier, key_ids=text.key_ids, cipher=text.cipher, tag=text.tag).wire()
    return CapturedMessage("capture.jsonl", number, raw, Sealed.topic, "", -1, {})


def judged(run: Run, *texts: SealedText) -> Counter:
    part = Part([], [], [], [], [seen(i, text) for i, text in enumerate(texts, 2)])
    return judge(SealedOnce, evidence(run.folder), part)


def wrong(counted: int, failures: int, text: str, messages: int = 2, opened: int = 2) -> Counter:
    note = f"{messages} messages, {opened} opened"
    return Counter(counted, failures, Place("", -1, -1, text), note)


def test_what_travels_as_it_was_sealed_passes(run: Run) -> None:
    """Counted: three that travelled, two as stored, two as opened, two that are no clear text."""
    assert judged(run, run.m, run.n, run.m) == Counter(9, note="2 messages, 2 opened")


def test_without_a_capture_there_is_nothing_to_look_at(run: Run) -> None:
    found = judge(SealedOnce, evidence(run.folder, wire=None))
    assert found == Counter(skipped="no capture in this run's folder")


def test_what_is_no_message_is_another_checks_matter(run: Run) -> None:
    part = Part(
        [], [], [], [], [CapturedMessage("capture.jsonl", 2, b"{", Sealed.topic, "", -1, {})]
    )
    assert judge(SealedOnce, evidence(run.folder), part) == Counter(4, note="0 messages, 2 opened")


@pytest.mark.parametrize(("cipher", "what"), [(None, "tag"), (b"at nino", "cipher, tag")])
def test_a_message_that_travels_twice_is_the_same(
    cipher: bytes | None, what: str, run: Run
) -> None:
    other = run.m._replace(cipher=cipher or run.m.cipher, tag="0" * 32)
    text = f"capture.jsonl line 3: sealed m: another {what}"
    assert judged(run, run.m, other, run.n) == wrong(9, 1, text)


def test_a_key_seals_one_message(run: Run) -> None:
    again = run.n._replace(key_ids=run.m.key_ids)
    text = f"capture.jsonl line 3: sealed n: key {run.m.key_ids[0]} sealed m already"
    assert judged(run, run.m, again) == wrong(8, 2, text)


def test_a_message_takes_as_many_keys_as_it_needs(run: Run) -> None:
    for ids in (run.m.key_ids[:1], run.m.key_ids[:1] * 2):
        text = f"capture.jsonl line 2: sealed m: 7 bytes under {len(ids)} keys"
        assert judged(run, run.m._replace(key_ids=ids), run.n) == wrong(8, 2, text)


def test_what_was_never_sealed_is_named(run: Run) -> None:
    stranger = run.m._replace(identifier="o", key_ids=("a", "b"))
    text = "sealed o: the controller: was never sealed"
    assert judged(run, run.m, run.n, stranger) == wrong(10, 1, text, messages=3)


def test_what_travels_otherwise_than_it_was_sealed_is_named(run: Run) -> None:
    text = "sealed m: the controller: another tag"
    assert judged(run, run.m._replace(tag="0" * 32), run.n) == wrong(8, 1, text)


def test_a_text_in_the_clear_is_named(run: Run) -> None:
    found = judged(run, run.m._replace(cipher=TEXT), run.n)
    assert (found.counted, found.failures) == (8, 2)
    (run.folder / CONTROLLER_KEYS).unlink()
    text = "sealed m: its text travelled in the clear"
    assert judged(run, run.m._replace(cipher=TEXT), run.n) == wrong(4, 1, text)


def test_what_was_opened_is_what_was_sealed(run: Run) -> None:
    with KeyStore(run.folder / PLANT_KEYS, "plant") as store, store.transaction() as db:
        db.execute("UPDATE opened SET payload = ? WHERE id = 'n'", (b"at ten.",))
    text = "sealed n: opened, and not as it was sealed"
    assert judged(run, run.m, run.n) == wrong(8, 1, text)
    with KeyStore(run.folder / PLANT_KEYS, "plant") as store, store.transaction() as db:
        db.execute("UPDATE opened SET payload = ?, id = 'o' WHERE id = 'n'", (TEXT,))
    text = "sealed o: opened, and not as it was sealed"
    assert judged(run, run.m, run.n) == wrong(8, 1, text)


def test_without_stores_what_travels_is_judged_by_itself(run: Run) -> None:
    (run.folder / PLANT_KEYS).unlink()
    assert judged(run, run.m, run.n) == Counter(4, note="2 messages, 0 opened")
    (run.folder / CONTROLLER_KEYS).unlink()
    assert judged(run, run.m, run.n) == Counter(2, note="2 messages, 0 opened")


def test_a_store_that_cannot_be_read_fails(run: Run) -> None:
    (run.folder / PLANT_KEYS).write_bytes(b"no store" * 99)
    found = judged(run, run.m, run.n)
    assert (found.counted, found.failures) == (4, 1)
    assert found.note == "2 messages, 0 opened"
