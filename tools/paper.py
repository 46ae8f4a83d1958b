"""The paper: its tables from the project's own data, and its PDF.

``python -m tools.paper`` (``make paper``) writes the tables between their marks in ``paper.md``
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
from studies.figures.loop import alpha_of, start_of, summaries
from studies.registry import between_marks, recorded
from studies.secrecy.tables import exact_of, share_of
from wyner.runs.score.report import percent

FOLDER: Final = Path(__file__).resolve().parent.parent / "paper"

EAVESDROPPERS: Final = {
    "set-membership": "as the paper models Eve",
    "nearest-centre": "takes the nearest prediction",
    "list-decoder": "follows all thresholds",
    "oracle": "a control: knows D_c",
}
ALPHAS: Final = (1.5, 3.0, 8.0)


def rates(data: Path = DATA) -> str:
    """The rate of the paper's example against alpha, from each initial state."""
    found = {(start_of(s), alpha_of(s)): s for s in summaries(data, "fig7-paper")}
    starts = list(dict.fromkeys(start for start, _ in found))
    lines = [
        "| initial state | " + " | ".join(f"α = {alpha:g}" for alpha in ALPHAS) + " |",
        "|:--------------|:---------------------|:---------------------|:---------------------|",
    ]
    for start in starts:
        cells = ["{:.3f} [{:.3f}, {:.3f}]".format(*found[start, alpha].rate) for alpha in ALPHAS]
        lines.append(f"| {start.removeprefix('x(0) = ')} | {' | '.join(cells)} |")
    runs = found[starts[0], ALPHAS[0]].runs
    caption = (
        f": Bits a second over 50 steps, {runs} runs, seed 7, 95 % intervals."
        " `wyner sweep fig7-paper`"
    )
    return "\n".join([*lines, "", caption])


def results(data: Path = DATA) -> str:
    """What eavesdroppers get under the law ``sustained``."""
    lines = [
        "| eavesdropper | runs | key symbols | messages |",
        "|:-----------------------|---:|:---------|:---------|",
    ]
    recorded_rows = recorded("secrecy-ladder", data)
    for tap, what in EAVESDROPPERS.items():
        rows = [
            r for r in recorded_rows if r["tap"] == tap and r["condition"] == "framed, 1000 steps"
        ]
        keys = share_of(rows, "keys_right_reviewed", "keys")
        lines.append(
            f"| `{tap}`: {what} | {len(rows)} | {percent(keys)} | {percent(exact_of(rows))} |"
        )
    caption = (
        ": The law `sustained` at α = 8: shares of key symbols and of whole messages, with 95 %"
        " intervals over runs. `python -m studies measure secrecy-ladder`"
    )
    return "\n".join([*lines, "", caption])


def with_results(text: str) -> str:
    """The paper with its tables made anew."""
    return between_marks(between_marks(text, "results", results()), "rate", rates())


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
    """Write the tables and build the PDF."""
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
