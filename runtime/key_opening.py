"""A service's key store as its scenario and its seed have it."""

from pathlib import Path
from typing import Protocol

from protocol.scenario import Scenario
from protocol.secret.records import Key, Side, StoreError
from runtime.errors import UsageError
from runtime.keys import coins
from runtime.keys.key_maker import KeyMakerAt
from runtime.keys.store import KeyStore


class Counting(Protocol):
    """What a key store needs of a side's record."""

    @property
    def session(self) -> str | None:
        """The session."""

    @property
    def transitions(self) -> int:
        """Its transitions so far."""


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
