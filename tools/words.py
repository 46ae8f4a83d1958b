"""How many words the pages have: ``python -m tools.words``.

A word has a letter or a digit; bars of tables have none. Programs on the pages are counted. Parts
that are made from the code or from data are not; they stand between marks, as the scenario
reference does as a whole. A test holds the sum to ``LIMIT``: who adds words takes others away.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from runtime.errors import DONE, USAGE

ROOT: Final = Path(__file__).resolve().parent.parent
LIMIT: Final = 20_000
"""Words of all pages together."""
README_LIMIT: Final = 600
"""Words of the page that a stranger reads first."""
PAGES_LIMIT: Final = 12
"""Pages in ``docs`` that somebody wrote, the index apart."""
GENERATED_PAGES: Final = ("scenario-reference.md", "command-reference.md")

_GENERATED: Final = re.compile(r"<!-- (?:generated|begin)\b.*?<!-- end\b.*?-->", re.DOTALL)
_WORD: Final = re.compile(r"\S*\w\S*")


def words(text: str) -> int:
    """The words of a page, its generated parts apart."""
    return len(_WORD.findall(_GENERATED.sub("", text)))


def pages() -> list[Path]:
    """The pages that somebody wrote."""
    docs = sorted((ROOT / "docs").rglob("*.md"))
    written = [page for page in docs if page.name not in GENERATED_PAGES]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *written]


def counted() -> dict[str, int]:
    """The words of each page, by its name in the checkout."""
    return {
        page.relative_to(ROOT).as_posix(): words(page.read_text(encoding="utf-8"))
        for page in pages()
    }


def main(arguments: Sequence[str] = ()) -> int:
    """Print the words of each page and their sum."""
    if arguments:
        print("usage: python -m tools.words", file=sys.stderr)
        return USAGE
    found = counted()
    for name, number in found.items():
        print(f"{number:6}  {name}")
    print(f"{sum(found.values()):6}  of {LIMIT}")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
