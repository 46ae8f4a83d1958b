"""Key stores by what is in them: what a key maker makes of a task is worked out once."""

import hashlib
import zlib
from functools import cache
from unittest.mock import patch

from protocol.secret.records import Key, Side
from protocol.secret.tasks import Done, Task
from runtime.keys import coins
from runtime.keys.key_maker import KeyMaker, work
from runtime.keys.store import KeyStore
from tests.support.giving import agree


class Stores:
    """Key stores by what is in them, each kept once."""

    def __init__(self) -> None:
        self._images: dict[Side, list[bytes]] = {"plant": [], "controller": []}
        self.keys: dict[Side, list[dict[str, tuple[str, bytes | None]]]] = {
            "plant": [],
            "controller": [],
        }
        self._numbers: dict[bytes, int] = {}
        self._worked: dict[tuple[Side, int, Task], tuple[int, Done]] = {}
        self._held: dict[tuple[Side, int, str | None], tuple[int, tuple[Key, ...]]] = {}
        self._agreed: dict[tuple[int, int], tuple[int, int]] = {}
        for side in self._images:
            self.put(KeyStore(None, side))

    def put(self, store: KeyStore) -> int:
        """The number of a store as it is now."""
        rows = [store.blocks(), *store.ids(), *store.compare().values()]
        told = repr([row._replace(t_ns=0) for row in store.blocks()]) + repr(rows[1:])
        told += repr((store.uses(), store.rows("SELECT use, what, names, refused FROM asked")))
        digest = hashlib.blake2b(f"{store.side} {told}".encode(), digest_size=16).digest()
        if digest not in self._numbers:
            images = self._images[store.side]
            self._numbers[digest] = len(images)
            images.append(zlib.compress(store.db.serialize(), 1))
            self.keys[store.side].append(
                {
                    name: (state, key)
                    for (name, state), key in zip(
                        store.ids(), store.compare().values(), strict=True
                    )
                }
            )
        return self._numbers[digest]

    def work(self, side: Side, number: int, task: Task) -> tuple[int, Done]:
        """What a key maker makes of a task: the number of its store afterwards, and its answer."""
        known = self._worked.get((side, number, task))
        if known is None:
            store = self._filled(side, number)
            with patch.object(coins, "new_use", _use):
                done = work(KeyMaker(store), task)
            known = self._worked[side, number, task] = self.put(store), done
        return known

    def coin_keys(
        self, side: Side, number: int, session: str | None
    ) -> tuple[int, tuple[Key, ...]]:
        """What a new process finds for the coin of its session, and its store afterwards."""
        known = self._held.get((side, number, session))
        if known is None:
            store = self._filled(side, number)
            keys = coins.held(store, session)
            known = self._held[side, number, session] = self.put(store), keys
        return known

    def agreed(self, plant: int, controller: int) -> tuple[int, int]:
        """Both stores once each end has asked the other what may be given."""
        known = self._agreed.get((plant, controller))
        if known is None:
            theirs = self._filled("plant", plant)
            mine = self._filled("controller", controller)
            agree(mine, theirs)
            known = self._agreed[plant, controller] = self.put(theirs), self.put(mine)
        return known

    def _filled(self, side: Side, number: int) -> KeyStore:
        """The one open store of a side, with what is in that number."""
        store = _open(side)
        store.db.deserialize(zlib.decompress(self._images[side][number]))
        return store


@cache
def _open(side: Side) -> KeyStore:
    return KeyStore(None, side)


def _use(kind: str, name: str = "") -> str:
    """The same name whenever the same is asked for, so that a step is a function."""
    return f"{kind} {name} 0"
