"""Which key the coin of a step comes from, at both ends: sans I/O, and nothing twice.

The controller names a key in its offers with the step of its first digit, for as long as the key
has digits; then comes the next one. Keys serve in the order in which they were set aside. One that
was left is never named again, by any process of the journal: the record keeps the newest name, and
what stands before it has served. The plant holds to the same: it takes no key that stands before
the newest, nor that one from another first step. Where the two do not meet, the plant's coin is
private, and the controller does not test it.
"""

from collections.abc import Iterable
from math import inf
from typing import Final

from protocol.agreement import NO_SYMBOL
from protocol.messages import Offer
from protocol.secret.key_digits import digits
from protocol.secret.records import Key
from protocol.secret.tasks import CoinKeys, CoinTask

BATCH: Final = 32
"""Keys that are set aside at once, and as many are held ahead: 4096 steps each of M = 4."""

AGAIN_S: Final = 0.1
"""Seconds until the controller asks again whether the plant has marked a batch; then twice as
long, and so on."""

LACKING_S: Final = 1.0
"""Seconds between two looks for what is not there, at most."""


class _Coins:
    """Keys of one session, in the order in which they serve.

    Parameters
    ----------
    size : int
        M.
    on : bool
        Whether the coin is keyed at all.
    """

    def __init__(self, size: int, *, on: bool) -> None:
        self.on = on
        self._size = size
        self._asked = False

    def _begin(self, session: str, keys: Iterable[Key], key: str, first: int, keep: str) -> None:
        """Begin a session, or go on with it: ``key`` is the newest that has served.

        Those before ``keep`` are gone; all are, where it is not there any more.
        """
        self._session = session if self.on else ""
        self.key, self.first = key, first
        """The newest key that has served, and the step of its first digit."""
        self._digits: dict[str, tuple[int, ...]] = {}
        self.again_at = -inf
        """When it looks again for keys that it lacked, on the loop's clock, in seconds."""
        held = list(keys) if self.on else []
        names = [held_key.key_id for held_key in held]
        since = names.index(keep) if keep in names else len(names)
        self._served = names[: since if keep else 0]
        self._add(held[since if keep else 0 :])
        self._newest = names[-1] if names else ""

    def _add(self, keys: Iterable[Key]) -> None:
        for key in keys:
            self._digits[key.key_id] = digits(key.key, self._size)
            self._newest = key.key_id

    def digit_of(self, offer: Offer) -> int | None:
        """The digit of an offer, by the key that it names, if that is held."""
        name, first = offer.coin_key, offer.coin_from
        if not name or first is None:
            return None
        found, at = self._digits.get(name, ()), offer.k - first
        return found[at] if 0 <= at < len(found) else None

    def _task(self, number: int, served: tuple[str, ...]) -> CoinTask:
        self._asked = True
        return CoinTask(self._session, self._newest, number, served)

    def _take(self, done: CoinKeys) -> None:
        """Take keys that were asked for."""
        self._asked = False
        if done.session == self._session:
            self._add(done.keys)


class OfferedCoins(_Coins):
    """The controller's: names keys in offers, and tells which candidate must explain x(k+1)."""

    def __init__(self, size: int, *, on: bool) -> None:
        super().__init__(size, on=on)
        self.wait_s = AGAIN_S
        """Seconds until it asks once more after a batch that is not marked."""
        self.begin(None)

    def begin(
        self,
        session: str | None,
        keys: Iterable[Key] = (),
        key: str = "",
        first: int = -1,
        applied: str = "",
    ) -> None:
        """Begin a session, or go on with it from what was read back.

        Parameters
        ----------
        session : str or None
        keys : iterable of Key
            That the store holds for the session's coin, in order.
        key, first : str, int
            The newest key that an offer named, and the step of its first digit.
        applied : str
            The key of the offer that is still to be counted, if another one.
        """
        self._begin(session or "", keys, key, first, applied or key)
        held = list(self._digits)
        since = held.index(key) + 1 if key in held else len(held) * bool(key)
        self._ahead = held[since:]
        self._pending, self._dry = True, False

    @property
    def left(self) -> int:
        """Keys that are held for steps to come."""
        return len(self._ahead)

    def named(self, k: int) -> tuple[str | None, int | None, str | None]:
        """What the offer of step ``k`` says: key, first step, and the newest key held."""
        if not self.on:
            return None, None, None
        while self._exhausted(k) and self._ahead:
            if self.key:
                self._served.append(self.key)
            self.key, self.first = self._ahead.pop(0), k
        if self._exhausted(k):
            return "", 0, self._newest
        return self.key, self.first, self._newest

    def _exhausted(self, k: int) -> bool:
        found = self._digits.get(self.key)
        return found is None or k >= self.first + len(found)

    def expected(self, applied: Offer, key: str | None) -> int:
        """The candidate of an applied offer, where the plant says it came from ``key``; or -1."""
        if not key or key != applied.coin_key:
            return NO_SYMBOL
        digit = self.digit_of(applied)
        return NO_SYMBOL if digit is None else digit

    def confirmed(self) -> None:
        """A key block was confirmed: there are keys to set aside."""
        self._dry = False

    def tasks(self, now: float) -> tuple[CoinTask, ...]:
        """What the keeper of keys must do now: set keys aside, erase those that have served."""
        if not self._session or self._asked or len(self._ahead) >= BATCH:
            return ()
        if self._dry or (self._pending and now < self.again_at):
            return ()
        # the last one may have to be tested once more, by the process that comes after this one
        served = tuple(self._served[:-1])
        del self._served[:-1]
        for name in served:
            self._digits.pop(name, None)
        return (self._task(BATCH, served),)

    def done(self, done: CoinKeys, now: float) -> None:
        """Take keys that were set aside and marked."""
        self._take(done)
        if done.session == self._session:
            self._ahead += [key.key_id for key in done.keys]
            self._pending = done.pending
            self._dry = not done.pending and not done.keys
        waits = self._pending and not done.keys
        self.again_at = now + self.wait_s
        self.wait_s = min(2 * self.wait_s, LACKING_S) if waits else AGAIN_S


class AppliedCoins(_Coins):
    """The plant's: the digit that chooses a candidate, where offer and store agree on it."""

    def __init__(self, size: int, *, on: bool) -> None:
        super().__init__(size, on=on)
        self.begin("")

    def begin(self, session: str, keys: Iterable[Key] = (), key: str = "", first: int = -1) -> None:
        """Begin a session, or go on with it from what was read back."""
        self._begin(session, keys, key, first, key)
        self._wanted = ""

    def digit(self, offer: Offer) -> int | None:
        """The candidate of this offer, for the step that is about to be made; None: unkeyed.

        A key that is named for the first time is bound to its first step, and all keys before it
        are left.
        """
        name, first = offer.coin_key, offer.coin_from
        self._wanted = self._lacked(offer.coin_last or name or "")
        if not name or first is None or first > offer.k or name not in self._digits:
            return None
        if name != self.key:
            for before in list(self._digits):
                if before == name:
                    break
                del self._digits[before]
                self._served.append(before)
            self.key, self.first = name, first
        elif first != self.first:
            return None
        return self.digit_of(offer)

    def tasks(self, now: float) -> tuple[CoinTask, ...]:
        """What the keeper of keys must do now: read what was marked, erase what has served."""
        if not self._session or not self._wanted or self._asked or now < self.again_at:
            return ()
        served = tuple(self._served)
        self._served.clear()
        return (self._task(0, served),)

    def done(self, done: CoinKeys, now: float) -> None:
        """Take keys that the controller has had marked."""
        self._take(done)
        self._wanted = self._lacked(self._wanted)
        self.again_at = -inf if done.keys else now + LACKING_S

    def _lacked(self, newest: str) -> str:
        """The newest key that the controller holds, if this end has not read it yet; or nothing.

        This end may hold newer ones, which the controller has not been told of yet.
        """
        return "" if newest in self._digits or newest == self._newest else newest
