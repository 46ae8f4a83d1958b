"""Two key stores whose ends ask each other what may be given, without services or buses."""

from collections.abc import Callable, Sequence

from protocol.secret.records import WHOLE, Key, Share
from runtime.keys.asking import Asker
from runtime.keys.giving import Giver, pending
from runtime.keys.store import KeyStore

from protocol.messages import Message
from tests.support.mail import mail


def agree(*stores: KeyStore) -> None:
    """Each of two ends asks what it has to ask, and the other one answers."""
    ends = [Asker(store) for store in stores]
    for asker, partner in (ends, ends[::-1]):
        ask(asker, partner, 0.0)


def ask(asker: Asker, partner: Asker, now: float) -> None:
    """One end asks what it has to ask; all that is said comes to the other in its order."""
    said: list[tuple[Asker, Asker, Message]]
    said = [(partner, asker, out) for out in asker.wake(now)]
    while said:
        hearer, speaker, message = said.pop(0)
        said += [(speaker, hearer, out) for out in hearer.receive(*mail(message)).publish]


def consent(store: KeyStore) -> None:
    """A partner that marks whatever it is asked for."""
    for use, _, _ in pending(store):
        store.answered(use, ())


def looking(store: KeyStore, partner: KeyStore | None) -> Callable[[], None]:
    """What a giver does while it waits."""
    return (lambda: consent(store)) if partner is None else (lambda: agree(store, partner))


def deliver(
    store: KeyStore,
    number: int = 1,
    who: str = "",
    share: Share = WHOLE,
    partner: KeyStore | None = None,
) -> tuple[Key, ...]:
    """Keys of a store's own half; ``partner`` marks them, or one that marks everything."""
    return Giver(store, look=looking(store, partner)).deliver(number, who, share)


def deliver_named(
    store: KeyStore,
    ids: Sequence[str],
    who: str = "",
    share: Share = WHOLE,
    partner: KeyStore | None = None,
) -> tuple[Key, ...]:
    """Keys of the partner's half by their ids."""
    return Giver(store, look=looking(store, partner)).deliver_named(ids, who, share)
