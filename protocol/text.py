"""Foreign text made safe to print: one line without control characters."""


def printable(text: str) -> str:
    """Text on one line. Control characters and what cannot be shown become ``·``."""
    return "".join(c if c.isprintable() else "·" for c in text)


def readable(payload: bytes) -> str:
    """A payload as one line of text: undecodable and unprintable characters as ``·``."""
    return printable(payload.decode("utf-8", errors="replace").replace("\ufffd", "·"))


class Shown:
    """Caches `readable` of the last payload."""

    def __init__(self) -> None:
        self._payload, self._text = b"", ""

    def text(self, payload: bytes) -> str:
        """The payload as one line of text."""
        if payload != self._payload:
            self._payload, self._text = payload, readable(payload)
        return self._text
