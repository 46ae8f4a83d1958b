"""Lines of a trace by hand, whole as the services write them."""

from typing import Any


def transition(session: str, j: int, k: int, *, size: int = 2, **fields: Any) -> dict[str, Any]:
    """A test transition of the plant's trace, of two states and one input, with these fields."""
    line: dict[str, Any] = {"event": "transition", "session": session, "j": j, "k": k}
    line |= {"x": [0.0, 0.0], "candidates": [[float(i)] for i in range(size)], "cipher": 0}
    line |= {"x_next": [0.0, 0.0], "role": "test", "gauges": [1.0] * size, "symbol": -1}
    line |= {"key": -1, "message_symbol": -1, "p": 0, "s": 1, "counts": 0, "coin": 0, "u": [0.0]}
    return line | fields


def at_controller(line: dict[str, Any], **fields: Any) -> dict[str, Any]:
    """The same transition in the controller's trace."""
    kept = {name: value for name, value in line.items() if name not in ("coin", "u")}
    return kept | fields
