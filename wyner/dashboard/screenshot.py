"""A screen as files: SVG in colour and plain text, the same bytes for the same screen."""

import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.text import Text

_FONT_FACES: Final = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)


def to_text(lines: Sequence[Text]) -> str:
    """The lines without styles or trailing blanks."""
    return "".join(line.plain.rstrip() + "\n" for line in lines)


def to_svg(lines: Sequence[Text], width: int, title: str = "wyner dashboard") -> str:
    """The lines as an SVG picture; it fetches nothing, fonts included."""
    console = Console(
        file=StringIO(),
        width=width,
        record=True,
        force_terminal=True,
        color_system="truecolor",
        no_color=False,
        highlight=False,
        _environ={},
    )
    for line in lines:
        console.print(line, no_wrap=True, overflow="crop")
    return _FONT_FACES.sub("", console.export_svg(title=title))


def save(lines: Sequence[Text], width: int, folder: Path) -> tuple[Path, Path]:
    """Write ``screen-N.svg`` and ``screen-N.txt`` with the first N that is free.

    Raises
    ------
    OSError
        When the folder cannot be written.
    """
    number = 1
    while (folder / f"screen-{number}.svg").exists() or (folder / f"screen-{number}.txt").exists():
        number += 1
    svg, text = folder / f"screen-{number}.svg", folder / f"screen-{number}.txt"
    for path, content in ((svg, to_svg(lines, width)), (text, to_text(lines))):
        with path.open("x", encoding="utf-8") as file:  # never through a link
            file.write(content)
    return svg, text
