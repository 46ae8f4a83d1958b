"""Random ids."""

from runtime.ids import new_id


def test_ids_are_random_and_well_formed() -> None:
    ids = {new_id() for _ in range(100)}
    assert len(ids) == 100
    assert all(len(i) == 16 and int(i, 16) >= 0 for i in ids)
