"""The documents' diagrams as SVG: every label of the source is in the picture."""

import re
import xml.etree.ElementTree as ET
from html import unescape
from pathlib import Path

import pytest

from tools.mermaid import CHARACTER, DiagramError, drawn

DOCS = Path(__file__).resolve().parents[2] / "docs"
SOURCES = [
    source
    for path in sorted(DOCS.rglob("*.md"))
    for source in re.findall(r"```mermaid\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
]


@pytest.mark.parametrize("source", SOURCES, ids=range(len(SOURCES)))
def test_every_label_of_a_diagram_is_drawn_within_the_picture(source: str) -> None:
    picture = ET.fromstring(drawn(source))
    _, _, width, height = (float(v) for v in (picture.get("viewBox") or "").split())
    seen = []
    for text in picture.iter("text"):
        label, x, y = text.text or "", float(text.get("x") or 0), float(text.get("y") or 0)
        seen.append(label)
        half = CHARACTER * len(label) / 2
        middle = x + half if text.get("text-anchor") == "start" else x
        assert 0 <= middle - half <= middle + half <= width
        assert 0 < y <= height
    labels = re.findall(r"(?:: | as |^\s*par )(.+)$", source, re.MULTILINE)
    for part in (part for label in labels for part in label.split("<br/>")):
        assert any(unescape(part) in label for label in seen), part
    arrows = len(re.findall(r"-->|>>", source))
    heads = [p for p in picture.iter("path") if p.get("marker-end")]
    assert len(heads) == arrows


def test_labels_do_not_overlap() -> None:
    for source in SOURCES:
        boxes = []
        for text in ET.fromstring(drawn(source)).iter("text"):
            x, y, half = float(text.get("x") or 0), float(text.get("y") or 0), len(text.text or "")
            left = x if text.get("text-anchor") == "start" else x - half * 6 / 2
            boxes.append((left, y - 11, left + half * 6, y + 2))
        for i, a in enumerate(boxes):
            for b in boxes[:i]:
                assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1], (a, b)


@pytest.mark.parametrize(
    "source",
    ["flowchart LR\n a --> b", "sequenceDiagram\n loop all\n end", "stateDiagram-v2\n x", ""],
)
def test_what_cannot_be_drawn_is_an_error(source: str) -> None:
    with pytest.raises(DiagramError, match="expected"):
        drawn(source)


def test_labels_cannot_act() -> None:
    source = "sequenceDiagram\nparticipant A as <b>\nparticipant B as b\nA->>B: <script>"
    assert "<script>" not in drawn(source)
