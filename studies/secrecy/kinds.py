"""The study of kinds: messages of twelve kinds, and whether what `text` states of each comes true.

``python -m studies.secrecy.kinds`` adds to ``docs/data/secrecy-kinds.csv`` the runs that it lacks
and puts the table on docs/findings.md. Passwords and code are kept back: nothing in the reader was
made or chosen with them in view.
"""

import argparse
import base64
import hashlib
import multiprocessing
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from protocol.statistics import wilson
from studies import DATA
from studies.pages import markdown_table
from studies.secrecy.reading_tables import Row, median, read_rows, tails
from studies.secrecy.runs import simulate
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.study import append_rows, heard_by, stated_by
from studies.secrecy.tables import codes_of, put_on_page
from tap_service.capture.channel import View
from tap_service.eavesdroppers.text import Text
from wyner.sweeps.code import code_version

FILE: Final = DATA / "secrecy-kinds.csv"

WRITTEN: Final = Path(__file__).with_name("kinds.txt")
"""Messages of the kinds that are written by hand: a kind in brackets, then a message a line."""

MESSAGES: Final = 20
"""Of a kind."""

LOSSES: Final = (0.3, 0.5)
"""Shares of the datagrams that Eve misses, in turn."""

FIRST_SEED: Final = 3000

KEPT_BACK: Final = ("code", "passwords")

PRINTABLE: Final = "".join(map(chr, range(33, 127)))

COLUMNS: Final = (
    "task", "version", "kind", "seed", "loss", "keys", "probability", "likeliest_exact",
    "bits_left", "message_bits", "given", "cpu_s",
)  # fmt: skip

HEAD: Final = (
    "kind", "read at 30 %", "read at 50 %", "stated sum", "right", "P[as few]", "P[as many]",
    "bits left at 30 %", "at 50 %", "expectation", "code",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Message:
    """One message before Eve."""

    kind: str
    number: int
    payload: bytes

    @property
    def seed(self) -> int:
        """Of the run: the same for the same number in every kind."""
        return FIRST_SEED + self.number

    @property
    def loss(self) -> float:
        """What Eve misses."""
        return LOSSES[self.number % len(LOSSES)]

    @property
    def id(self) -> str:
        """A hash of what is measured."""
        text = f"{self.kind} {self.seed} {self.loss} {self.payload!r}"
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def messages() -> Iterator[Message]:
    """All messages; capitals are the sentences in capitals, so that the two can be compared."""
    kinds = {"sentences": list(SENTENCES[:MESSAGES])}
    kinds["capitals"] = [text.upper() for text in kinds["sentences"]]
    for line in WRITTEN.read_text(encoding="ascii").splitlines():
        if line.startswith("[") and line.endswith("]"):
            written = kinds[line[1:-1]] = []
        else:
            written.append(line)
    rng = random.Random("kinds")
    kinds["hex"] = [rng.randbytes(rng.randrange(8, 21)).hex() for _ in range(MESSAGES)]
    kinds["base64"] = [
        base64.b64encode(rng.randbytes(rng.randrange(12, 31))).decode() for _ in range(MESSAGES)
    ]
    kinds["passwords"] = [
        "".join(rng.choices(PRINTABLE, k=rng.randrange(10, 21))) for _ in range(MESSAGES)
    ]
    for number in range(MESSAGES):
        for kind, texts in kinds.items():
            yield Message(kind, number, texts[number].encode("ascii"))


def version() -> str:
    """Of the code that the rows come from."""
    return code_version("studies.secrecy.kinds")


def measure(message: Message) -> dict[str, object]:
    """One row."""
    run = simulate(320, message.seed, name="packed", payloads=[message.payload])
    view = View(loss=message.loss, seed=message.seed)
    tap = Text(view.knowledge(run.scenario.knowledge()), live=False)
    begun = time.process_time()
    for transition in heard_by(run, view):
        tap.observe(transition)
    reviewed = {guess.k: guess.best for guess in tap.review()}
    right = sum(reviewed.get(k) == key for (_, k), key in run.truth.keys.items())
    belief = tap.belief()
    return {
        "task": message.id,
        "version": version(),
        "kind": message.kind,
        "seed": message.seed,
        "loss": message.loss,
        "keys": f"{right / len(run.truth.keys):.4f}",
        "given": belief.given,
        **stated_by(belief, message.payload, begun),
    }


def table(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """One line a kind: what was read, and what was stated against what came right."""
    lines: list[tuple[str, ...]] = [HEAD]
    for kind in dict.fromkeys(message.kind for message in messages()):
        mine = [row for row in rows if row["kind"] == kind]
        stated = [float(row["probability"]) for row in mine]
        right = sum(int(row["likeliest_exact"]) for row in mine)
        few, many = tails(stated, right)
        by_loss = [[row for row in mine if float(row["loss"]) == loss] for loss in LOSSES]
        left = [median([float(row["bits_left"]) for row in part]) for part in by_loss]
        given = [row["given"] for row in mine]
        likeliest = max(set(given), key=given.count)
        lines.append(
            (
                f"{kind} (kept back)" if kind in KEPT_BACK else kind,
                *(_read(part) for part in by_loss),
                f"{sum(stated):.2f}",
                f"{right} of {len(mine)}",
                f"{few:.3f}",
                f"{many:.3f}",
                *(interval.text(".1f") for interval in left),
                f"{likeliest} ({given.count(likeliest)})",
                codes_of(mine),
            )
        )
    return lines


def _read(rows: Sequence[Row]) -> str:
    """How many were the likeliest message, with Wilson's interval."""
    right = sum(int(row["likeliest_exact"]) for row in rows)
    return wilson(right, len(rows)).scaled(100.0).text(".0f", " %")


def main() -> None:
    """Measure what is lacking, and write the table."""
    parser = argparse.ArgumentParser(description="Measure the study of kinds.")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--only", default="", help="a kind (default: all)")
    parser.add_argument("--output", type=Path, default=FILE, help="file (default: the shipped one)")
    args = parser.parse_args()
    wanted = [message for message in messages() if args.only in message.kind]
    context = multiprocessing.get_context("spawn")
    with context.Pool(args.jobs, maxtasksperchild=40) as pool:
        append_rows(
            args.output,
            COLUMNS,
            wanted,
            lambda todo: pool.imap_unordered(measure, todo),
            version(),
        )
    found = markdown_table(table(read_rows(args.output)))
    if args.output == FILE and not args.only:
        put_on_page({"kinds": found})
    else:
        print(found)


if __name__ == "__main__":
    main()
