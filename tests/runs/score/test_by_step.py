"""Numbers by step are a dict's, in less room."""

import tracemalloc

from hypothesis import given
from hypothesis import strategies as st

from wyner.runs.score.by_step import LARGEST, TOGETHER, BySteps

STEPS = st.tuples(
    st.sampled_from(["a", "b"]),
    st.integers(-3, 12) | st.sampled_from([TOGETHER - 1, TOGETHER, 10**18, -(10**18)]),
)
VALUES = st.integers(-2, 3) | st.just(LARGEST)


@given(st.lists(st.tuples(STEPS, VALUES | st.none())))
def test_it_is_a_dict(changes: list[tuple[tuple[str, int], int | None]]) -> None:
    mine, plain = BySteps(), dict[tuple[str, int], int]()
    for at, value in changes:
        if value is None:
            assert mine.pop(at, None) == plain.pop(at, None)
        else:
            mine[at] = plain[at] = value
        assert mine == plain
        assert len(mine) == len(plain)
        assert (at in mine) == (at in plain)
    assert BySteps(plain.items()) == plain


def test_steps_take_two_bytes_each() -> None:
    steps = 100_000
    tracemalloc.start()
    mine = BySteps((("0" * 16, k), k % 4) for k in range(steps))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(mine) == steps
    assert peak < 3 * steps
