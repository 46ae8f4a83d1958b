"""Keys of few digits, so that the key stream is filled and runs dry all the time."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from unittest.mock import patch

from protocol.secret import key_digits, stream


@contextmanager
def short_keys(count: int) -> Iterator[None]:
    """A key has the first ``count`` of its digits alone within."""

    @cache
    def first(key: bytes, size: int) -> tuple[int, ...]:
        return key_digits.digits(key, size)[:count]

    with patch.object(stream, "digits", first):
        yield
