"""What comes from elsewhere, as text for people: one line, and nothing in it that acts."""


def printable(text: str) -> str:
    """Text on one line: what could move a cursor, or cannot be shown, is ``·``."""
    return "".join(c if c.isprintable() else "·" for c in text)


def readable(payload: bytes) -> str:
    """A payload as one line of text: undecodable and unprintable characters as ``·``."""
    return printable(payload.decode("utf-8", errors="replace").replace("\ufffd", "·"))


class Shown:
    """`readable` of a payload that is asked for again and again while it stays the same."""

    def __init__(self) -> None:
        self._payload, self._text = b"", ""

    def text(self, payload: bytes) -> str:
        """The payload as one line of text."""
        if payload != self._payload:
            self._payload, self._text = payload, readable(payload)
        return self._text
