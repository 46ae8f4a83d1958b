"""A service's key store as its scenario and its seed have it."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from protocol.link.peer import Actions, Peer
from protocol.scenario import Scenario
from protocol.secret.records import Key, Side, StoreError
from protocol.secret.tasks import GuardTask
from runtime.errors import UsageError
from runtime.keys import coins, guards
from runtime.keys.key_maker import KeyMakerAt
from runtime.keys.store import KeyStore

if TYPE_CHECKING:
    from protocol.defence.base import Defence
    from protocol.link.guarded import Guarded


class Counting(Protocol):
    """What a key store needs of a side's record."""

    @property
    def session(self) -> str | None:
        """The session."""

    @property
    def k(self) -> int:
        """The step that it is in."""

    @property
    def transitions(self) -> int:
        """Its transitions so far."""


class End(Peer, Protocol):
    """An end that may be guarded."""

    @property
    def instance(self) -> str:
        """Random id of its process."""

    def end_session(self, why: str) -> Actions:
        """Its session is over, since messages in it cannot be opened."""


def refusal(scenario: Scenario, seed: int | None) -> str | None:
    """Why nobody gets a key of a run, in one line; None where they do."""
    if scenario.keys is None:
        return f"scenario {scenario.name} has no table keys, so no key is made"
    reason = scenario.keys.refusal()
    if reason is None and seed is not None:
        reason = f"seed {seed}: this run's keys are predictable, and nobody gets them"
    return reason


def open_key_maker(
    path: Path,
    side: Side,
    scenario: Scenario,
    seed: int | None,
    record: Counting | None = None,
) -> KeyMakerAt | None:
    """Make a side's key store ready; None where the scenario has no table ``keys``.

    A store is there also where no key will be: it says why. ``record`` is the journal's: a new
    store makes no key of a block that began before it, since one that was removed may have.

    Raises
    ------
    UsageError
        When the store cannot be used.
    """
    if scenario.keys is None:
        return None
    try:
        store = KeyStore(path, side, create=True)
    except StoreError as error:
        raise UsageError(str(error)) from None
    try:
        reason = refusal(scenario, seed)
        if reason is not None:
            store.refuse(reason)
        begun = (None, 0) if record is None else (record.session, record.transitions)
        store.begin(*begun)
        store.set_note("assumption", scenario.keys.assumption().sentence())
    except StoreError as error:
        raise UsageError(str(error)) from None
    finally:
        store.close()
    return KeyMakerAt(path, side)


def coin_keys(
    at: KeyMakerAt | None, scenario: Scenario, record: Counting | None
) -> tuple[Key, ...]:
    """Keys that a side's store holds for the coin of the session that its journal is in.

    Raises
    ------
    UsageError
        When the store cannot be used.
    """
    if at is None or record is None or not scenario.defence.keyed:
        return ()
    try:
        with KeyStore(at.path, at.side) as store:
            return coins.held(store, record.session)
    except StoreError as error:
        raise UsageError(str(error)) from None


def guarded(
    end: End,
    at: KeyMakerAt | None,
    scenario: Scenario,
    record: Counting | None,
    halt: Callable[[], Actions] | None = None,
) -> "Guarded | None":
    """The end with its messages guarded, by the keys that its store holds; None where none is.

    Raises
    ------
    UsageError
        When the store cannot be used.
    """
    if at is None or not scenario.defence.guards:
        return None
    defence = scenario.defence.guard(scenario.readings, scenario.secrecy.candidates)
    assert defence is not None, "its messages are guarded"
    try:
        with KeyStore(at.path, at.side) as store:
            return guarded_by(end, store, defence, record, halt)
    except StoreError as error:
        raise UsageError(str(error)) from None


def guarded_by(
    end: End,
    store: KeyStore,
    defence: "Defence",
    record: Counting | None,
    halt: Callable[[], Actions] | None = None,
) -> "Guarded":
    """The end with its messages guarded, by the keys that its open store holds.

    Parameters
    ----------
    end : End
    store : KeyStore
        Of its side.
    defence : Defence
        That codes or tags.
    record : Counting, optional
        The journal's.
    halt : callable, optional
        What the end does over a forgery, beside telling it.

    Raises
    ------
    StoreError
        When the store cannot be used.
    """
    from protocol.link.guarded import MARGIN, Guarded

    session = None if record is None else record.session
    keys = None
    if record is not None and session is not None:
        sends = store.side == "plant" or defence.tags
        words = (defence.session_words, defence.step_words) if sends else (0, 0)
        task = GuardTask(session, end.instance, record.k, record.k + MARGIN, *words)
        keys = guards.serve(store, task)
    return Guarded(end, store.side, defence, end.instance, end.end_session, session, keys, halt)
