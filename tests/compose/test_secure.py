"""The field bus through a router that asks for certificates."""

import pytest

from tests.compose.composition import (
    Composition,
    all_healthy,
    arrives,
    under_way,
)

SERVICES = ("router", "secure-controller", "secure-plant", "secure-tap")


def test_the_message_arrives_through_the_router(secure: Composition) -> None:
    all_healthy(secure, SERVICES)
    arrives(secure, "secure-plant", "at noon")


@pytest.mark.parametrize(
    ("service", "text"), [("router", "router dies"), ("secure-controller", "sender dies")]
)
def test_the_loop_outlives_the_death_of(secure: Composition, service: str, text: str) -> None:
    all_healthy(secure, SERVICES)
    under_way(secure, text, "secure-controller")
    secure.kill(service)
    arrives(secure, "secure-plant", text)
