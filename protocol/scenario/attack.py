"""``[attack]``: the attacker: which attack, from which step on, and what the attacker knows."""

import json
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from protocol.scenario.parts import ScenarioTable
from protocol.wrong_fields import wrong_fields

Place = Literal["sensor", "bus", "actuator"]
Knowable = Literal["model", "bus", "coins"]


class AttackTable(ScenarioTable, extra="allow"):
    """An attack on this loop; further fields are the options of its class."""

    kind: str
    """The attack, by name or FILE.py:CLASS."""
    at: Place | None = None
    """Where it stands; where its class does, if not given."""
    onset: Annotated[int, Field(ge=1)]
    """The first step whose reading, input or message is not the true one."""
    knows: tuple[Knowable, ...] = ("model", "bus", "coins")
    """What the attacker is told: A, B, D_c, U; public offers; the coins of keys that Eve has."""

    @property
    def options(self) -> dict[str, Any]:
        """The options of its class."""
        return dict(self.model_extra or {})


def attack_of(text: str, stated: AttackTable | None = None) -> AttackTable:
    """The attack that ``KIND@ONSET[,NAME=VALUE...]`` names.

    Parameters
    ----------
    text : str
        A value is JSON, or else a word: ``ghost@200,knows=["model","bus"]``.
    stated : AttackTable, optional
        The scenario's own: where it is of that kind, what is not said here stands as it says.

    Raises
    ------
    ValueError
        With one line.
    """
    head, *pairs = _parts(text)
    kind, at, onset = head.rpartition("@")
    if not at or not kind or not onset.isdecimal():
        raise ValueError(f"got {text!r}, expected KIND@ONSET, such as ghost@200")
    fields: dict[str, Any] = {}
    if stated is not None and stated.kind == kind:
        fields = stated.model_dump(exclude_unset=True)
    fields |= {"kind": kind, "onset": int(onset)}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name.isidentifier():
            raise ValueError(f"got {pair!r}, expected NAME=VALUE")
        try:
            fields[name] = json.loads(value)
        except ValueError:
            fields[name] = value
    try:
        return AttackTable.model_validate(fields)
    except ValidationError as error:
        raise ValueError(wrong_fields(error)[0]) from None


def _parts(text: str) -> list[str]:
    """The text between commas that stand in no bracket."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts
