"""The queue between the transport's thread and a service's own."""

import queue
import threading

import pytest

from runtime.inbox import OVERHEAD, Inbox


def test_items_come_in_order_and_are_counted() -> None:
    inbox: Inbox[int] = Inbox()
    for item in range(5):
        inbox.put(item, 0)
    assert len(inbox) == 5
    assert [inbox.get(0.0) for _ in range(5)] == list(range(5))
    assert not inbox
    with pytest.raises(queue.Empty):
        inbox.get(0.0)


def test_nothing_is_lost_between_several_that_put_and_one_that_takes() -> None:
    inbox: Inbox[tuple[int, int]] = Inbox(10**9)

    def put(n: int) -> None:
        for i in range(5000):
            inbox.put((n, i), 0)

    puts = [threading.Thread(target=put, args=(n,)) for n in range(4)]
    for thread in puts:
        thread.start()
    taken = [inbox.get(10.0) for _ in range(4 * 5000)]
    for n in range(4):
        assert [i for m, i in taken if m == n] == list(range(5000))
    assert not inbox


def test_what_there_is_no_room_for_is_dropped_and_counted() -> None:
    inbox: Inbox[bytes] = Inbox(10_000)
    for _ in range(5):
        inbox.put(b"x", 4000)
    assert (len(inbox), inbox.dropped) == (2, 3)
    assert [inbox.get(0.0), inbox.get(0.0)] == [b"x", b"x"]
    inbox.put(b"y", 10_000 - OVERHEAD)
    inbox.put(b"z", 0)
    assert (len(inbox), inbox.dropped) == (1, 4)
