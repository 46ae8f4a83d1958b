"""An application's side of ETSI GS QKD 014: fetch a key as master, or by its id as slave."""

import base64
import http.client
import json
import ssl
from collections.abc import Sequence
from contextlib import closing
from typing import Final
from urllib.parse import quote

from protocol.secret.nonces import NONCE_BYTES
from protocol.secret.records import Key

TIMEOUT_S: Final = 5.0
MOST_BYTES: Final = 64 * 1024


class NoKey(Exception):
    """An entity that gives no key; the text is one line and says why."""


class KeyClient:
    """One application's entity, a connection a request.

    Parameters
    ----------
    host : str
    port : int
    tls : ssl.SSLContext
        With the application's certificate.
    """

    def __init__(self, host: str, port: int, tls: ssl.SSLContext) -> None:
        self._address = host, port
        self._tls = tls

    def enc_keys(self, slave: str, number: int = 1) -> list[Key]:
        """New keys, for this application and ``slave``.

        Raises
        ------
        NoKey
        """
        return self._ask(f"{quote(slave, safe='')}/enc_keys", {"number": number})

    def dec_keys(self, master: str, ids: Sequence[str]) -> list[Key]:
        """The keys that ``master`` has fetched under these ids, all or none.

        Raises
        ------
        NoKey
        """
        asked = {"key_IDs": [{"key_ID": name} for name in ids]}
        return self._ask(f"{quote(master, safe='')}/dec_keys", asked)

    def _ask(self, path: str, body: object) -> list[Key]:
        host, port = self._address
        connection = http.client.HTTPSConnection(host, port, context=self._tls, timeout=TIMEOUT_S)
        try:
            with closing(connection):
                headers = {"Content-Type": "application/json"}
                connection.request("POST", f"/api/v1/keys/{path}", json.dumps(body), headers)
                answer = connection.getresponse()
                told = json.loads(answer.read(MOST_BYTES))
                if answer.status != http.client.OK:
                    raise NoKey(f"{host}:{port}: {answer.status} {told['message']}")
                keys = [Key(k["key_ID"], base64.b64decode(k["key"])) for k in told["keys"]]
        except (OSError, http.client.HTTPException) as error:
            raise NoKey(f"{host}:{port}: {error}") from None
        except (ValueError, LookupError, TypeError):
            raise NoKey(f"{host}:{port}: expected an answer of ETSI GS QKD 014") from None
        if not keys or any(len(key.key) != NONCE_BYTES for key in keys):
            raise NoKey(f"{host}:{port}: expected keys of {8 * NONCE_BYTES} bits")
        return keys
