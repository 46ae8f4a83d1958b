"""A screen as text."""

from io import StringIO

from rich.console import Console, RenderableType


def to_text(shown: RenderableType, size: tuple[int, int]) -> str:
    """What fills a screen, without styles or trailing blanks."""
    console = Console(file=StringIO(), width=size[0], color_system=None, record=True)
    console.print(shown, height=size[1], end="")
    text = console.export_text()
    return "".join(line.rstrip() + "\n" for line in text.splitlines())
