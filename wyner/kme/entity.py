"""A key management entity, sans I/O: who asks, for whom, and what the store gives."""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

from pydantic import ValidationError

from protocol.secret.nonces import NONCE_BYTES
from protocol.secret.records import (
    Key,
    KeysRefused,
    OthersKeys,
    Share,
    StoreError,
    TooFewKeys,
    UnknownKeys,
)
from runtime.keys.giving import Giver, Unanswered
from runtime.keys.store import MOST_KEYS, KeyStore
from wyner.kme.messages import (
    DeliveredKey,
    Error,
    KeyContainer,
    KeyId,
    KeyIds,
    KeyRequest,
    KmeAnswer,
    Request,
    Status,
)

KEY_BITS: Final = 8 * NONCE_BYTES
MOST_AT_ONCE: Final = 32
"""Keys that one request may ask for."""

BAD_REQUEST: Final = 400
UNAUTHORISED: Final = 401
UNAVAILABLE: Final = 503

R = TypeVar("R", bound=Request)


class Refusal(Exception):
    """A request that is answered with an Error and this HTTP status."""

    def __init__(
        self, status: int, message: str, details: Iterable[Mapping[str, str]] = ()
    ) -> None:
        super().__init__(message)
        self.status = status
        self.error = Error(message=message, details=tuple(dict(d) for d in details))


@dataclass(frozen=True)
class Names:
    """Who is who on one link.

    Parameters
    ----------
    kme, partner_kme : str
        The entity at this site, and the one at the other.
    pairs : tuple of (str, str)
        The common names in the certificates of an application that this entity serves and of its
        partner at the other site; the other entity has the same pairs in the same order.
    """

    kme: str
    partner_kme: str
    pairs: tuple[tuple[str, str], ...]


class KeyManagementEntity:
    """Serves one side's store to its applications, each pair with a share of the keys.

    As master the application gets keys of this side's own half, as slave those of the partner's
    half by their ids, which the master told it. So no key is handed to two masters. The other end
    has marked each before it is given: for that the services of both ends must run.

    Parameters
    ----------
    names : Names
    store : KeyStore
    giver : Giver, optional
        Of that store.
    """

    def __init__(self, names: Names, store: KeyStore, giver: Giver | None = None) -> None:
        self.names = names
        self._store = store
        self._giver = giver or Giver(store)

    @property
    def refused(self) -> str | None:
        """Why nobody gets a key here, or None."""
        return self._store.refused

    def ready(self) -> str:
        """How many keys each pair may fetch here as master, or why none, in words."""
        if self.refused is not None:
            return f"no key: {self.refused}"
        pairs = self.names.pairs
        return ", ".join(
            f"{self._store.available(Share(place, len(pairs)))} keys ready for {mine} with {theirs}"
            for place, (mine, theirs) in enumerate(pairs)
        )

    def status(self, caller: str, slave: str) -> Status:
        """Get status: section 5.1.

        Raises
        ------
        Refusal
            401 for a caller that is not served here, 400 for another slave, 503 without a store.
        """
        share = self._share(caller, slave, "slave_SAE_ID")
        try:
            available, extension = self._store.available(share), self._extension()
        except StoreError as error:
            raise Refusal(UNAVAILABLE, f"no key: {error}") from None
        return Status(
            source_KME_ID=self.names.kme,
            target_KME_ID=self.names.partner_kme,
            master_SAE_ID=caller,
            slave_SAE_ID=slave,
            key_size=KEY_BITS,
            stored_key_count=available,
            max_key_count=MOST_KEYS,
            max_key_per_request=MOST_AT_ONCE,
            max_key_size=KEY_BITS,
            min_key_size=KEY_BITS,
            max_SAE_ID_count=0,
            status_extension=extension,
        )

    def get_key(self, caller: str, slave: str, request: KeyRequest) -> KeyContainer:
        """Get key: section 5.2; the oldest confirmed keys of this side's half, given once.

        Raises
        ------
        Refusal
            401 and 400 as :meth:`status`, 400 for what cannot be asked, 503 without enough keys.
        """
        share = self._share(caller, slave, "slave_SAE_ID")
        if request.extension_mandatory:
            raise Refusal(BAD_REQUEST, "not all extension_mandatory parameters are supported")
        if request.additional_slave_SAE_IDs:
            raise _wrong("additional_slave_SAE_IDs", "expected none, max_SAE_ID_count is 0")
        size = KEY_BITS if request.size is None else request.size
        if size % 8:
            raise Refusal(BAD_REQUEST, "size shall be a multiple of 8")
        if size != KEY_BITS:
            raise _wrong("size", f"got {size}, expected {KEY_BITS}")
        if not 1 <= request.number <= MOST_AT_ONCE:
            raise _wrong("number", f"got {request.number}, expected 1 to {MOST_AT_ONCE}")
        try:
            keys = self._giver.deliver(request.number, caller, share)
        except (TooFewKeys, KeysRefused, StoreError, Unanswered) as error:
            raise Refusal(UNAVAILABLE, f"no key: {error}") from None
        return self._container(keys)

    def get_key_with_ids(self, caller: str, master: str, ids: Iterable[str]) -> KeyContainer:
        """Get key with key IDs: section 5.3; keys of the partner's half, all or none, given once.

        Raises
        ------
        Refusal
            401 for a caller that no key was meant for, 400 for unknown ids, 503 as above.
        """
        share = self._share(caller, master, "master_SAE_ID")
        wanted = list(dict.fromkeys(ids))
        if len(wanted) > MOST_AT_ONCE:
            raise _wrong("key_IDs", f"got {len(wanted)}, expected {MOST_AT_ONCE} at most")
        try:
            keys = self._giver.deliver_named(wanted, caller, share)
        except OthersKeys as error:
            message = f"{len(error.ids)} keys are not for SAE {caller!r}"
            raise Refusal(UNAUTHORISED, message, ({"key_ID": i} for i in error.ids)) from None
        except UnknownKeys as error:
            message = "one or more keys specified are not found on KME"
            raise Refusal(BAD_REQUEST, message, ({"key_ID": i} for i in error.ids)) from None
        except (KeysRefused, StoreError, Unanswered) as error:
            raise Refusal(UNAVAILABLE, f"no key: {error}") from None
        return self._container(keys)

    def _share(self, caller: str, other: str, field: str) -> Share:
        pairs = self.names.pairs
        partners = [theirs for mine, theirs in pairs if mine == caller]
        if not partners:
            raise Refusal(UNAUTHORISED, f"SAE {caller!r}: not served by {self.names.kme}")
        if other not in partners:
            expected = " or ".join(map(repr, partners))
            raise _wrong(field, f"got {other!r}, expected {expected}")
        return Share(pairs.index((caller, other)), len(pairs))

    def _container(self, keys: Iterable[Key]) -> KeyContainer:
        told = tuple(
            DeliveredKey(key_ID=k.key_id, key=base64.b64encode(k.key).decode()) for k in keys
        )
        return KeyContainer(keys=told, key_container_extension=self._extension())

    def _extension(self) -> dict[str, str]:
        """The claim under which the keys are secret, with every answer."""
        return {"assumption": self._store.assumption}


def _wrong(field: str, reason: str) -> Refusal:
    return Refusal(BAD_REQUEST, f"{field}: {reason}", ({field: reason},))


def parsed(model: type[R], body: bytes) -> R:
    """A request's body, or what its query says, as an object.

    Raises
    ------
    Refusal
        400 with one detail for each wrong field.
    """
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        details = [
            {".".join(map(str, e["loc"])) or "body": e["msg"]}
            for e in error.errors(include_url=False, include_input=False)
        ]
        raise Refusal(BAD_REQUEST, f"not a {model.__name__}", details) from None


def key_request_of(query: Mapping[str, str]) -> KeyRequest:
    """What a GET asks for by ``number`` and ``size``.

    Raises
    ------
    Refusal
        400 when one is no whole number.
    """
    values = {}
    for name in ("number", "size"):
        if name in query:
            try:
                values[name] = int(query[name])
            except ValueError:
                raise _wrong(name, f"got {query[name]!r}, expected a whole number") from None
    return KeyRequest(**values)


def key_ids_of(query: Mapping[str, str]) -> KeyIds:
    """What a GET asks for by ``key_ID``.

    Raises
    ------
    Refusal
        400 when there is none.
    """
    if not query.get("key_ID"):
        raise _wrong("key_ID", "got none, expected one")
    return KeyIds(key_IDs=(KeyId(key_ID=query["key_ID"][:64]),))


def as_json(answer: KmeAnswer) -> bytes:
    """An answer as it is sent: without the optional fields that it does not have."""
    return answer.model_dump_json(exclude_defaults=True).encode()
