"""The attacks that are shipped, a class a file, and how to find one by name."""

from typing import Final

from attacker_service.base import Attack, AttackError
from protocol.plugins import UnknownError, load_class

ATTACKS: Final = {
    "ghost": "attacker_service.attacks.ghost:Ghost",
    "replay": "attacker_service.attacks.replay:Replay",
    "bias": "attacker_service.attacks.bias:Bias",
    "covert": "attacker_service.attacks.covert:Covert",
    "stuck": "attacker_service.attacks.stuck:Stuck",
}


def named(name: str) -> type[Attack]:
    """The class of an attack, by its name or as ``FILE.py:CLASS``.

    Raises
    ------
    AttackError
        With one line, when there is no such attack.
    """
    try:
        return load_class(name, ATTACKS, Attack)
    except UnknownError as error:
        raise AttackError(f"attack.kind: {error}") from None
