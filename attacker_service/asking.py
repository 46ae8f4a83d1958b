"""An attack as those who host it see it: made and asked in a process of its own.

Light to load: whoever hosts it loads neither her code nor her eavesdropper.
"""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Any, Final

from pydantic import ValidationError

from attacker_service import LACKS
from protocol.link.events import AttackBegan
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.scenario import Attack, Scenario
from protocol.vectors import Vector
from runtime.errors import UsageError
from runtime.logs import logger
from runtime.sandbox import START_S, SandboxError, SandboxProcess, acquire, give_back

ANSWER_S: Final = 2.0
"""Seconds that an attack has for a step."""

LONGEST: Final = 1 << 16
"""Bytes of a message that an attack reads at most; the ends' own are far shorter."""

BusMessage = tuple[str, bytes]
"""A message's topic and payload."""


def brief(scenario: Scenario, attack: Attack, seed: int | None) -> dict[str, Any]:
    """What an attack is made of: numbers and names alone, for its own process.

    The eavesdropper beside it hears through the scenario's own tap channel.
    """
    rows = (*scenario.defender.disturbance.rows(), *scenario.control.inputs.rows())
    return {
        "kind": attack.kind,
        "at": attack.at,
        "onset": attack.onset,
        "knows": attack.knows,
        "options": attack.options,
        "model": (scenario.A, scenario.B, *rows),
        "linear": scenario.defender.model is None,
        "knowledge": scenario.knowledge().model_dump_json(),
        "view": scenario.tap.model_dump(exclude={"eavesdroppers"}),
        "seed": seed,
    }


class Sieve:
    """Tells the loop's own messages from whatever else is on its bus: an attack sees no junk.

    Parameters
    ----------
    scenario : Scenario

    Attributes
    ----------
    ignored : int
        Messages that were none of the loop's.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.ignored = 0
        self._n = scenario.n
        self._offered = [scenario.m] * scenario.secrecy.candidates

    def read(self, kind: type[FieldMessage], payload: bytes) -> FieldMessage | None:
        """The message; None, and counted, where it is none, or of another loop's shape."""
        try:
            message = kind.model_validate_json(payload) if len(payload) <= LONGEST else None
        except ValidationError:
            message = None
        if isinstance(message, Measurement):
            fits = len(message.x) == self._n and len(message.x_after) in (0, self._n)
        elif isinstance(message, Offer):
            fits = [len(u) for u in message.candidates] == self._offered
        else:
            fits = message is not None
        self.ignored += not fits
        return message if fits else None

    def tell(self) -> None:
        """Say in a line how many were ignored."""
        if self.ignored:
            log = logger("attacker")
            log.info("attack: %d messages on the bus were none of the loop's", self.ignored)


class Attacker:
    """An attack in its own process. Where it fails, the truth passes from then on.

    Parameters
    ----------
    scenario : Scenario
    attack : Attack
    seed : int, optional
        Of its draws; the operating system's if not given.

    Attributes
    ----------
    at : str
        Where it stands.
    began : AttackBegan
        Every parameter, as it is traced.
    failed : str
        Why it is over; empty while it is not.
    sieve : Sieve
        What its messages go through first.

    Raises
    ------
    UsageError
        With one line, when there is no such attack, or it cannot do with what it is given.
    """

    def __init__(self, scenario: Scenario, attack: Attack, seed: int | None) -> None:
        if scenario.plant.C is not None:
            raise UsageError("attack: expected none beside plant.C: attacks know whole states only")
        self.failed = ""
        self.sieve = Sieve(scenario)
        self._process: SandboxProcess = acquire("attacker_service.sandboxed")
        try:
            made = self._process.ask("make", brief(scenario, attack, seed), START_S)
            self.at = str(made["at"])
            options = dict(made["options"])
        except SandboxError as error:
            self._process.close()
            text = str(error) if error.kind == LACKS else f"attack.kind: {attack.kind}: {error}"
            raise UsageError(text) from None
        self.began = AttackBegan(
            {
                "kind": attack.kind,
                "at": self.at,
                "onset": attack.onset,
                "knows": attack.knows,
                "options": options,
            }
        )

    def vector(self, what: str, k: int, true: Vector, beside: Iterable[object] = ()) -> Vector:
        """What it puts in place of a ``true`` vector of step ``k``, as long and finite."""
        rows = self._asked(what, k, true, tuple(beside))
        return true if rows is None else self._checked(k, [rows], [true])[0]

    def vectors(self, what: str, k: int, true: Sequence[Vector]) -> tuple[Vector, ...]:
        """The same of vectors."""
        rows = self._asked(what, k, tuple(true), ())
        return tuple(true) if rows is None else self._checked(k, rows, true)

    def _asked(self, what: str, k: int, true: object, beside: tuple[object, ...]) -> Any:
        if self.failed:
            return None
        try:
            return self._process.ask(what, (k, true, beside), ANSWER_S)
        except SandboxError as error:
            self._over(k, str(error))
            return None

    def _checked(self, k: int, rows: Any, true: Sequence[Vector]) -> tuple[Vector, ...]:
        try:
            found = tuple([tuple([float(v) for v in row]) for row in rows])
        except (TypeError, ValueError):
            found = ()
        if [len(row) for row in found] != [len(row) for row in true] or not all(
            isfinite(v) for row in found for v in row
        ):
            shape = " and ".join(str(len(row)) for row in true)
            self._over(k, f"got {rows!r:.60}, expected {shape} finite numbers")
            return tuple(true)
        return found

    def _over(self, k: int, why: str) -> None:
        self.failed = why
        logger("attacker").error("attack: %s; from step %d on the truth passes", why, k)

    def close(self) -> None:
        """Let go of it."""
        self.sieve.tell()
        give_back(self._process)
