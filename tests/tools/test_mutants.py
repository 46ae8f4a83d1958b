"""The sample of mutants: seeded, of each room, and told with its interval."""

from tools.mutants import drawn, table

NAMES = [
    f"{room}.m.x_f__mutmut_{i}" for room in ("protocol.link", "wyner.verify") for i in range(50)
]


def test_a_sample_is_that_of_its_seed() -> None:
    first = drawn(NAMES, 10, 1)
    assert first == drawn(NAMES[::-1], 10, 1) != drawn(NAMES, 10, 2)
    assert [sum(n.startswith(room) for n in first) for room in ("protocol.link", "wyner")] == [
        10
    ] * 2
    assert len(drawn(NAMES, 60, 1)) == 100


def test_the_table_counts_what_was_tried_and_names_the_survivors() -> None:
    statuses = dict.fromkeys(NAMES, "not checked")
    for i, status in enumerate(["killed"] * 7 + ["timeout", "survived", "no tests"]):
        statuses[NAMES[i]] = status
    assert table(statuses, NAMES).splitlines() == [
        "protocol.link: 8 of 10 killed, 80.0 % [49.0, 94.3]",
        "  survived: protocol.link.m.x_f__mutmut_8",
        "  no tests: protocol.link.m.x_f__mutmut_9",
    ]
