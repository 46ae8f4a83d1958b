"""The entity over HTTPS: who asks is in the certificate; nobody can make it wait.

aiohttp is used because it knows the client's certificate. The store's writes go to the disk, so
they are made on a thread of their own, one at a time.
"""

import asyncio
import ssl
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Final
from weakref import WeakKeyDictionary

from aiohttp import web

from protocol.secret.records import StoreError
from runtime.rates import Burst
from wyner.kme.entity import (
    BAD_REQUEST,
    UNAUTHORISED,
    UNAVAILABLE,
    KeyManagementEntity,
    Refusal,
    as_json,
    key_ids_of,
    key_request_of,
    parsed,
)
from wyner.kme.identity import common_name
from wyner.kme.messages import KeyContainer, KeyIds, KeyRequest, KmeAnswer

MOST_BYTES: Final = 64 * 1024
"""Of a request's body."""

MOST_CONNECTIONS: Final = 200
HANDSHAKE_S: Final = 5.0
BODY_S: Final = 5.0
IDLE_S: Final = 15.0
"""A connection that completes no request for so long is closed."""

POLL_S: Final = 0.5

Asked = Callable[[str, web.Request], Awaitable[KmeAnswer]]


class KeyServer:
    """One entity's HTTP.

    Parameters
    ----------
    entity : KeyManagementEntity
    rate : float
        Requests a second that one caller may make, and twice as many at once.
    """

    def __init__(self, entity: KeyManagementEntity, rate: float) -> None:
        self._entity = entity
        self.allowed = defaultdict[str, Burst](lambda: Burst(2 * rate, rate))
        self._writer = ThreadPoolExecutor(1, "keys")
        self._given = self._refused = 0
        self._last: WeakKeyDictionary[asyncio.BaseTransport, float] = WeakKeyDictionary()

    def application(self) -> web.Application:
        """Its three methods, and an Error for all else."""
        app = web.Application(client_max_size=MOST_BYTES, middlewares=[self._errors])
        for path, methods in (
            ("/api/v1/keys/{sae}/status", {"GET": self._status}),
            ("/api/v1/keys/{sae}/enc_keys", {"GET": self._get_key, "POST": self._post_key}),
            ("/api/v1/keys/{sae}/dec_keys", {"GET": self._get_ids, "POST": self._post_ids}),
        ):
            for method, asked in methods.items():
                app.router.add_route(method, path, partial(self._answer, asked))
        return app

    def health(self) -> str:
        """A line for its health file: ``ok`` or ``bad``, and what there is to give."""
        try:
            state = "bad" if self._entity.refused else "ok"
        except StoreError:
            state = "bad"
        return f"{state}: {self.summary()}"

    def summary(self) -> str:
        """What there is to give, and what was given and refused since the start."""
        try:
            ready = self._entity.ready()
        except StoreError as error:
            ready = str(error)
        return f"{ready}, {self._given} given, {self._refused} requests refused"

    async def serve(self, host: str, port: int, tls: ssl.SSLContext, stop: asyncio.Event) -> None:
        """Serve until ``stop``.

        Raises
        ------
        OSError
            When the address cannot be listened at.
        """
        runner = web.AppRunner(self.application(), access_log=None, keepalive_timeout=IDLE_S)
        await runner.setup()
        assert runner.server is not None
        listening = await asyncio.get_running_loop().create_server(
            runner.server, host, port, ssl=tls, ssl_handshake_timeout=HANDSHAKE_S
        )
        try:
            while not stop.is_set():
                self._close_idle(runner.server, time.monotonic())
                try:
                    await asyncio.wait_for(stop.wait(), POLL_S)
                except TimeoutError:
                    continue
        finally:
            listening.close()
            await runner.cleanup()
            self._writer.shutdown()

    def _close_idle(self, server: web.Server, now_s: float) -> None:
        """Close what has asked nothing for long, and the longest idle ones above the most."""
        transports = [h.transport for h in server.connections if h.transport is not None]
        for transport in transports:
            self._last.setdefault(transport, now_s)
        by_age = sorted(transports, key=lambda t: self._last[t])
        for place, transport in enumerate(by_age):
            surplus = place < len(by_age) - MOST_CONNECTIONS
            if surplus or now_s - self._last[transport] > IDLE_S:
                transport.abort()

    # --- requests ---------------------------------------------------------------------------------

    async def _answer(self, asked: Asked, request: web.Request) -> web.Response:
        assert request.transport is not None
        caller = common_name(request.transport.get_extra_info("peercert"))
        if caller is None:
            raise Refusal(UNAUTHORISED, "certificate: expected exactly one common name")
        if not self.allowed[caller].allows(time.monotonic()):
            raise Refusal(UNAVAILABLE, "too many requests; ask again in a second")
        answer = await asked(caller, request)
        if isinstance(answer, KeyContainer):
            self._given += len(answer.keys)
        self._last[request.transport] = time.monotonic()
        return web.Response(body=as_json(answer), content_type="application/json", charset="utf-8")

    async def _on_disk(self, call: Callable[[], KmeAnswer]) -> KmeAnswer:
        # A client that hangs up must not leave half a delivery behind: it is made to its end.
        loop = asyncio.get_running_loop()
        return await asyncio.shield(loop.run_in_executor(self._writer, call))

    async def _status(self, caller: str, request: web.Request) -> KmeAnswer:
        return await self._on_disk(partial(self._entity.status, caller, _sae(request)))

    async def _get_key(self, caller: str, request: web.Request) -> KmeAnswer:
        asked = key_request_of(request.query)
        return await self._on_disk(partial(self._entity.get_key, caller, _sae(request), asked))

    async def _post_key(self, caller: str, request: web.Request) -> KmeAnswer:
        asked = parsed(KeyRequest, await _body(request) or b"{}")
        return await self._on_disk(partial(self._entity.get_key, caller, _sae(request), asked))

    async def _get_ids(self, caller: str, request: web.Request) -> KmeAnswer:
        return await self._with_ids(caller, request, key_ids_of(request.query))

    async def _post_ids(self, caller: str, request: web.Request) -> KmeAnswer:
        return await self._with_ids(caller, request, parsed(KeyIds, await _body(request)))

    async def _with_ids(self, caller: str, request: web.Request, asked: KeyIds) -> KmeAnswer:
        ids = tuple(k.key_ID for k in asked.key_IDs)
        named = self._entity.get_key_with_ids
        return await self._on_disk(partial(named, caller, _sae(request), ids))

    @web.middleware
    async def _errors(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Every refusal as the standard's Error, the server's own among them."""
        try:
            return await handler(request)
        except Refusal as refusal:
            self._refused += 1
            status, error = refusal.status, refusal.error
        except web.HTTPException as other:
            self._refused += 1
            status = other.status
            error = Refusal(status, f"{request.method} {request.path}: {other.reason}").error
        return web.Response(
            status=status, body=as_json(error), content_type="application/json", charset="utf-8"
        )


def _sae(request: web.Request) -> str:
    return request.match_info["sae"]


async def _body(request: web.Request) -> bytes:
    try:
        return await asyncio.wait_for(request.read(), BODY_S)
    except TimeoutError:
        raise Refusal(BAD_REQUEST, f"body: not whole within {BODY_S:g} s") from None
