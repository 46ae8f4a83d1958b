"""Keys made by the loop and handed to two applications, and to nobody else."""

import json
import re
from collections.abc import Iterator

import pytest

from tests.compose.composition import PACE, RUN, Composition, all_healthy, wait_for
from tests.compose.conftest import running

SERVICES = ("keys-controller", "keys-plant", "keys-tap", "kme-controller", "kme-plant")

ASK = """
import json, sys
from pathlib import Path
from wyner.kme.client import KeyClient, NoKey
from wyner.kme.identity import tls_context
certificate, host, path = sys.argv[1:]
tls = tls_context(Path("/var/lib/wyner/certs") / certificate, server=False)
try:
    print(len(KeyClient(host, 8014, tls).enc_keys(path)), "keys")
except NoKey as error:
    print(error)
"""

STATES = f"""
import json, sys
from pathlib import Path
from runtime.keys.store import KeyStore
side, path = sys.argv[1:]
with KeyStore(Path("{RUN}") / path, side) as store:
    print(json.dumps(dict(store.ids())))
"""


@pytest.fixture(scope="module")
def keys(image: str) -> Iterator[Composition]:
    yield from running("wyner-test-keys", "keys", WYNER_PACE=PACE, WYNER_KEY_EVERY="1")


def in_use(system: Composition, application: str) -> list[str]:
    """The ids of the keys that an application has taken into use."""
    said = system.compose("logs", "--no-log-prefix", "--no-color", application).stdout
    return re.findall(r"in use: ([0-9a-f-]{36})", said)


def test_both_applications_use_the_same_fresh_keys(keys: Composition) -> None:
    all_healthy(keys, SERVICES)
    both = wait_for(
        lambda: ids if len(ids := in_use(keys, "alice")) >= 3 else None, "three keys", every_s=4.0
    )
    assert len(set(both)) == len(both)
    assert in_use(keys, "bob")[:3] == both[:3]
    for service, side in (("kme-controller", "controller"), ("kme-plant", "plant")):
        states = json.loads(keys.python(service, STATES, side, f"{side}/keys.sqlite3").stdout)
        assert {states[name] for name in both} == {"delivered"}


def test_nobody_else_gets_a_key(keys: Composition) -> None:
    all_healthy(keys, SERVICES)
    assert keys.python("alice", ASK, "alice", "kme.site-controller", "bob").stdout == "1 keys\n"
    refused = keys.python("kme-controller", ASK, "kme-controller", "kme.site-controller", "bob")
    assert "401 SAE 'kme-controller': not served" in refused.stdout
    networks = keys.inspect("kme-controller")["NetworkSettings"]["Networks"]
    (address,) = (network["IPAddress"] for network in networks.values())
    for outsider in ("keys-tap", "keys-controller", "bob"):
        attempt = f"import socket; socket.create_connection(('{address}', 8014), 2)"
        tried = keys.python(outsider, attempt, check=False)
        assert tried.stderr.endswith(("timed out\n", "unreachable\n")), tried.stderr
    held = keys.execute("keys-tap", "find", "/var/lib/wyner/certs", "-name", "*.pem")
    assert held.stdout == ""


def test_a_key_server_that_is_killed_comes_back_and_the_keys_go_on(keys: Composition) -> None:
    all_healthy(keys, SERVICES)
    keys.kill("kme-controller")
    before = len(in_use(keys, "alice"))
    wait_for(lambda: len(in_use(keys, "alice")) > before + 1, "fresh keys")
    alice, bob = in_use(keys, "alice"), in_use(keys, "bob")
    assert set(alice) <= set(bob)
    assert len(set(alice)) == len(alice)
