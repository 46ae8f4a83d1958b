"""What a command prints, for machines and for people."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Printout:
    """One object and some lines, which say the same.

    Parameters
    ----------
    figures : dict
        One object for machines.
    lines : list of str
        For people.
    """

    figures: dict[str, Any]
    lines: list[str]

    def __str__(self) -> str:
        """Lines for people."""
        return "\n".join(self.lines)
