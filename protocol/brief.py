"""Objects that a notebook shows: a line as their repr, a table as their HTML."""

from collections.abc import Mapping
from html import escape

LONGEST = 60
"""Characters of one value at most."""


class Brief:
    """What an object holds, in brief. Who extends it says so in :meth:`brief`."""

    __slots__ = ()

    def brief(self) -> Mapping[str, object]:
        """What is told, by its name."""
        raise NotImplementedError

    def __repr__(self) -> str:
        told = ", ".join(f"{name}={_short(value)}" for name, value in self.brief().items())
        return f"{type(self).__name__}({told})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(_short(value))}</td></tr>"
            for name, value in self.brief().items()
        )
        return f"<table><caption>{escape(type(self).__name__)}</caption>{rows}</table>"


def _short(value: object) -> str:
    text = " ".join((value if isinstance(value, str) else repr(value)).split())
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
