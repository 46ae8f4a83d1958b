"""How often something may happen."""


class Throttle:
    """Says when something may happen again: at most once in ``period_s`` seconds."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self._next = 0.0

    def ready(self, now_s: float) -> bool:
        """Whether the period is over at monotonic time ``now_s``; if so it begins anew."""
        if now_s < self._next:
            return False
        self._next = now_s + self.period_s
        return True


class Burst:
    """Lets a few through at once, and after them so many a second on average (a token bucket).

    Parameters
    ----------
    most : float
        At once.
    rate_hz : float
    """

    def __init__(self, most: float = 30.0, rate_hz: float = 1.0) -> None:
        self._most = most
        self._rate_hz = rate_hz
        self._left = most
        self._at = 0.0

    def allows(self, now_s: float) -> bool:
        """Whether one more may pass at monotonic time ``now_s``; if so it counts."""
        refilled = self._left + (now_s - self._at) * self._rate_hz
        self._left, self._at = min(refilled, self._most), now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True
