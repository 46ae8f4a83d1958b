"""The study of kinds: messages of twelve kinds, and whether what `text` states of each comes true.

Passwords and code are kept back: nothing in the reader was made or chosen with them in view.
"""

import base64
import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from protocol.statistics import wilson
from studies.registry import Lines, Row, study, table
from studies.secrecy.runs import simulate
from studies.secrecy.sentences import SENTENCES
from studies.secrecy.study import heard_by
from studies.secrecy.tables import median, tails
from tap_service.capture.channel import View
from tap_service.eavesdroppers.text import Text

WRITTEN: Final = Path(__file__).with_name("kinds.txt")
"""Messages of the kinds that are written by hand: a kind in brackets, then a message a line."""

MESSAGES: Final = 20
"""Of a kind."""

LOSSES: Final = (0.3, 0.5)
"""Shares of the datagrams that Eve misses, in turn."""

FIRST_SEED: Final = 5000

KEPT_BACK: Final = ("code", "passwords")

PRINTABLE: Final = "".join(map(chr, range(33, 127)))

HEAD: Final = (
    "kind", "read at 30 %", "read at 50 %", "stated in sum", "right", "P[as few]", "P[as many]",
    "bits left at 30 %", "at 50 %", "read as",
)  # fmt: skip


class Message(NamedTuple):
    """One message before Eve; the same number has the same seed in every kind."""

    kind: str
    number: int
    payload: bytes


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


@study(
    "secrecy-kinds",
    "kind seed loss probability likeliest_exact bits_left message_bits given cpu_s",
    messages,
)
def measure(message: Message) -> Iterator[dict[str, object]]:
    """One row."""
    seed, loss = FIRST_SEED + message.number, LOSSES[message.number % len(LOSSES)]
    run = simulate(320, seed, name="packed", payloads=[message.payload])
    view = View(loss=loss, seed=seed)
    tap = Text(view.knowledge(run.scenario.knowledge()), live=False)
    begun = time.process_time()
    for transition in heard_by(run, view):
        tap.observe(transition)
    tap.decode()
    belief = tap.belief()
    bits = 8 * len(message.payload)  # no message leaves more
    yield {
        "kind": message.kind,
        "seed": seed,
        "loss": loss,
        "given": belief.given,
        "probability": f"{belief.confidence:.6g}",
        "likeliest_exact": int(belief.message == message.payload),
        "bits_left": "" if belief.bits_left is None else f"{min(belief.bits_left, bits):.3f}",
        "message_bits": bits,
        "cpu_s": f"{time.process_time() - begun:.2f}",
    }


@table("kinds", "findings", "secrecy-kinds")
def by_kind(rows: Sequence[Row]) -> Lines:
    """One line a kind: what was read, and what was stated against what came right."""
    lines: list[tuple[str, ...]] = [HEAD]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if row["kind"] == kind]
        stated, right = [float(row["probability"]) for row in mine], _right(mine)
        by_loss = [[row for row in mine if float(row["loss"]) == loss] for loss in LOSSES]
        read = [wilson(_right(part), len(part)).scaled(100) for part in by_loss]
        left = [median([float(row["bits_left"]) for row in part]) for part in by_loss]
        taken, often = Counter(row["given"] for row in mine).most_common(1)[0]
        lines.append(
            (
                f"{kind} (kept back)" if kind in KEPT_BACK else kind,
                *(share.text(".0f", " %") for share in read),
                f"{sum(stated):.2f}",
                f"{right} of {len(mine)}",
                *(f"{tail:.3f}" for tail in tails(stated, right)),
                *(interval.text(".1f") for interval in left),
                f"{taken} ({often})",
            )
        )
    return lines


def _right(rows: Sequence[Row]) -> int:
    return sum(int(row["likeliest_exact"]) for row in rows)
