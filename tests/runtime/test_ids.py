"""Random ids, and words for fingerprints."""

import pytest

from runtime.ids import new_id, proquint


@pytest.mark.parametrize(
    ("address", "words"),  # the examples of the proposal, arXiv:0901.4016
    [
        ("7f000001", "lusab-babad"),  # 127.0.0.1
        ("3f54dcc1", "gutih-tugad"),  # 63.84.220.193
        ("3f760723", "gutuk-bisog"),  # 63.118.7.35
        ("8c62c18d", "mudof-sakat"),  # 140.98.193.141
        ("40ff06c8", "haguz-biram"),  # 64.255.6.200
        ("801e342d", "mabiv-gibot"),  # 128.30.52.45
        ("93437702", "natag-lisaf"),  # 147.67.119.2
    ],
)
def test_fingerprints_as_words(address: str, words: str) -> None:
    assert proquint(address, words=2) == words


def test_different_groups_are_different_words() -> None:
    assert len({proquint(f"{value:04x}", words=1) for value in range(2**16)}) == 2**16


def test_ids_are_random_and_well_formed() -> None:
    ids = {new_id() for _ in range(100)}
    assert len(ids) == 100
    assert all(len(i) == 16 and int(i, 16) >= 0 for i in ids)
