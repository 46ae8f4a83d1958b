"""What the studies write on the pages of docs/: tables in Markdown, between marks that stay."""

from collections.abc import Sequence


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """Lines as a table; the first is its head."""
    head, *rest = ("| " + " | ".join(line) + " |" for line in lines)
    return "\n".join([head, "|---" * len(lines[0]) + "|", *rest])


def between_marks(text: str, name: str, part: str) -> str:
    """The page with ``part`` between the marks of that name.

    Raises
    ------
    ValueError
        When the page lacks them.
    """
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    before, opened, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (opened and closed):
        raise ValueError(f"the page lacks the marks of {name!r}")
    return f"{before}{begin}{part}\n{end}{after}"
