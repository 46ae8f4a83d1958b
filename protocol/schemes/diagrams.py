"""Diagrams and tables of the documents, made from the tables that the programs run on.

``python -m protocol.schemes.diagrams --write`` puts them between their markers in
docs/architecture.md; a test says when they are stale.
"""

import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from protocol.messages import FIELD, INTEL, OPS, Message
from protocol.runtime.process import DONE, USAGE
from protocol.runtime.run_folder import PUBLIC_FILE, write_atomically
from protocol.schemes.switched import RECEIVER, SENDER, TEST, Row
from protocol.topics import key_of

DOCUMENT: Final = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"

_MARKED: Final = re.compile(
    r"(?P<begin><!-- generated: (?P<name>[a-z-]+) -->\n).*?(?P<end><!-- end -->)", re.DOTALL
)


def state_diagram(table: Sequence[Row]) -> str:
    """An automaton as a Mermaid state diagram; arrows between the same states share a line."""
    arrows: dict[tuple[int, int, str], list[str]] = {}
    for row in table:
        arrows.setdefault((row.state, row.next_state, row.action), []).append(row.event)
    lines = ["```mermaid", "stateDiagram-v2", "    direction LR", f"    [*] --> s{TEST}"]
    states = sorted({row.state for row in table})
    lines += [f"    s{s} : s = {s}" for s in states]
    for (state, following, action), events in arrows.items():
        event = "always" if len(events) == 2 else events[0]
        text = f"{event}<br/>{action.replace(';', ',')}"
        lines.append(f"    s{state} --> s{following} : {text}")
    return "\n".join([*lines, "```", ""])


def wire_table(kinds: Sequence[type[Message]]) -> str:
    """Messages of a bus: the key they travel on, and their fields."""
    lines = ["| message | key | fields |", "|---|---|---|"]
    for kind in kinds:
        fields = ", ".join(f"`{name}`" for name in kind.model_fields)
        lines.append(f"| `{kind.__name__}` | `{key_of(kind, 'LOOP')}` | {fields} |")
    return "\n".join([*lines, ""])


PARTS: Final[dict[str, Callable[[], str]]] = {
    "sender": lambda: state_diagram(SENDER),
    "receiver": lambda: state_diagram(RECEIVER),
    "field": lambda: wire_table(FIELD),
    "ops": lambda: wire_table(OPS),
    "intel": lambda: wire_table(INTEL),
}


def refreshed(text: str) -> str:
    """``text`` with every marked part made anew.

    Raises
    ------
    ValueError
        When a marker names no part, or a part has no marker.
    """
    names = [match["name"] for match in _MARKED.finditer(text)]
    if sorted(names) != sorted(PARTS):
        raise ValueError(f"markers: got {sorted(names)}, expected {sorted(PARTS)}")
    return _MARKED.sub(lambda m: m["begin"] + PARTS[m["name"]]() + m["end"], text)


def main(argv: Sequence[str]) -> int:
    """Print the parts, or write them into the document."""
    if list(argv) == ["--write"]:
        text = DOCUMENT.read_text(encoding="utf-8")
        write_atomically(DOCUMENT, refreshed(text).encode(), PUBLIC_FILE)
        return DONE
    if argv:
        print("usage: python -m protocol.schemes.diagrams [--write]", file=sys.stderr)
        return USAGE
    for name, part in PARTS.items():
        print(f"{name}\n\n{part()}")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
