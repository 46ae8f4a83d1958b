"""The paper: its table from the project's own data, and its PDF.

``python -m tools.paper`` (``make paper``) writes the table between its marks in ``paper/paper.md``
and builds ``paper/paper.pdf`` with pandoc and Typst, which the extra ``paper`` brings.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from runtime.errors import needs
from studies import DATA
from studies.registry import between_marks, recorded
from studies.secrecy.tables import exact_of, share_of
from wyner.runs.score.report import percent

FOLDER: Final = Path(__file__).resolve().parent.parent / "paper"

SHOWN: Final = (
    ("ladder", "framed, 1000 steps", "set-membership", "as the paper models her"),
    ("ladder", "framed, 1000 steps", "nearest-centre", "takes the nearest prediction"),
    ("ladder", "framed, 1000 steps", "list-decoder", "follows all readings"),
    ("ladder", "framed, 1000 steps", "oracle", "control: knows D_c"),
)


def results(data: Path = DATA) -> str:
    """The table of the paper, in Markdown."""
    lines = [
        "| eavesdropper | runs | key symbols | messages |",
        "|:-----------------------|---:|:---------|:---------|",
    ]
    for study, condition, tap, what in SHOWN:
        rows = [
            r
            for r in recorded(f"secrecy-{study}", data)
            if r["tap"] == tap and r["condition"] == condition
        ]
        keys = share_of(rows, "keys_right_reviewed", "keys")
        lines.append(
            f"| `{tap}`: {what} | {len(rows)} | {percent(keys)} | {percent(exact_of(rows))} |"
        )
    caption = ": Shares of key symbols and of whole messages; 95 % intervals over runs."
    return "\n".join([*lines, "", caption])


def with_results(text: str) -> str:
    """The paper with its table made anew."""
    return between_marks(text, "results", results())


def build(folder: Path, output: Path) -> None:
    """Turn ``paper.md`` into a PDF: citations by pandoc, the page by Typst."""
    import pypandoc
    import typst

    source = pypandoc.convert_file(
        str(folder / "paper.md"),
        "typst",
        extra_args=["--standalone", "--citeproc", f"--bibliography={folder / 'paper.bib'}"],
    )
    with tempfile.NamedTemporaryFile("w", suffix=".typ", dir=folder, encoding="utf-8") as file:
        file.write(source)
        file.flush()
        typst.compile(file.name, output=str(output), root=str(folder.parent))


def main(argv: Sequence[str] | None = None) -> int:
    """Write the table and build the PDF."""
    parser = argparse.ArgumentParser(prog="python -m tools.paper", description=main.__doc__)
    parser.add_argument("--output", type=Path, default=FOLDER / "paper.pdf")
    args = parser.parse_args(argv)
    path = FOLDER / "paper.md"
    path.write_text(with_results(path.read_text(encoding="utf-8")), encoding="utf-8")
    try:
        build(FOLDER, args.output)
    except ImportError as error:
        print(needs("paper", error.name or "pypandoc_binary typst"), file=sys.stderr)
        return 2
    print(args.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
