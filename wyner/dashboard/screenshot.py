"""A screen as files: SVG in colour and plain text, the same bytes for the same screen."""

import re
from io import StringIO
from pathlib import Path
from typing import Final

from rich.console import Console, RenderableType

Size = tuple[int, int]
"""Columns and rows."""

_FONT_FACES: Final = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)


def to_text(shown: RenderableType, size: Size) -> str:
    """What fills a screen, without styles or trailing blanks."""
    console = Console(file=StringIO(), width=size[0], color_system=None, record=True)
    console.print(shown, height=size[1], end="")
    text = console.export_text()
    return "".join(line.rstrip() + "\n" for line in text.splitlines())


def to_svg(shown: RenderableType, size: Size, title: str = "wyner dashboard") -> str:
    """The same as an SVG picture in colour; it fetches nothing, fonts included."""
    console = Console(
        file=StringIO(),
        width=size[0],
        record=True,
        force_terminal=True,
        force_jupyter=False,
        color_system="truecolor",
        no_color=False,
        highlight=False,
    )
    console.print(shown, height=size[1], end="")
    return _FONT_FACES.sub("", console.export_svg(title=title))


def save(shown: RenderableType, size: Size, folder: Path) -> tuple[Path, Path]:
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
    for path, content in ((svg, to_svg(shown, size)), (text, to_text(shown, size))):
        with path.open("x", encoding="utf-8") as file:  # never through a link
            file.write(content)
    return svg, text
