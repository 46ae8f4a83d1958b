"""All that is known about one step and one tap, on a page of its own."""

from collections.abc import Sequence

from rich.text import Text

from protocol.agreement import INSIDE
from wyner.dashboard import plane
from wyner.dashboard.model import Board, TapBoard
from wyner.dashboard.score import Score, characters_right
from wyner.dashboard.secrecy_panel import keys_right
from wyner.dashboard.text import (
    STYLES,
    Glyphs,
    component,
    count,
    drawn,
    figure,
    longest,
    number,
    row,
    rule,
)


def detail(
    board: Board,
    step: int | None,
    tap: tuple[TapBoard, Score] | None,
    taps: Sequence[tuple[TapBoard, Score]],
    width: int,
    glyphs: Glyphs,
) -> list[Text]:
    """The page: the chosen step (the last one pictured if none), what each tap said, one tap."""
    pictured = board.pictured
    k = step if step is not None else pictured.pictured_k if pictured is not None else -1
    lines = _step(board, k, width, glyphs)
    lines += [_said(board, its, k) for its, _ in taps]
    if tap is not None:
        lines += _tap(board, *tap, width, glyphs)
    return lines


def _step(board: Board, k: int, width: int, glyphs: Glyphs) -> list[Text]:
    lines = [rule(glyphs, f"Step {k}" if k >= 0 else "No step pictured yet", width)]
    truth, shown = board.truths.get(k), board.pictures.get(k)
    for label, at in (("state before", k), ("state after", k + 1)):
        x = board.states.get(at)
        if x is not None:
            lines.append(row(label, Text("  ".join(component(v, "+") for v in x))))
    if truth is not None:
        role = "tested for a key" if truth.role == "test" else "carried a message symbol"
        key = f"key symbol {truth.symbol}" if truth.symbol >= 0 else "no key symbol"
        lines.append(row("what happened", Text(f"input {truth.coin} applied, {role}, {key}")))
    if shown is not None:
        for i, (u, gauge) in enumerate(
            zip(shown.pictured_candidates, shown.pictured_gauges, strict=False)
        ):
            vector = "  ".join(component(v, "+") for v in u)
            where = "inside D_c" if gauge <= INSIDE else f"at {number(gauge)} times D_c"
            lines.append(row(f"input {i}", Text(f"{vector}   next state {where}")))
        lines.append(row("verdict", Text(plane.verdict(shown))))
    return lines


def _said(board: Board, tap: TapBoard, k: int) -> Text:
    guess, truth = tap.guesses.get(k), board.truths.get(k)
    if guess is None:
        return row(tap.status.name, Text("said nothing of this step", style=STYLES["label"]))
    text = Text(
        f"says symbol {guess.symbol}, sure to {guess.probability:.2f}; "
        f"that a key was agreed: {guess.agreed:.2f}  "
    )
    if truth is not None and truth.symbol >= 0:
        right = guess.symbol == truth.symbol
        text.append("right" if right else "wrong", style=STYLES["good" if right else "bad"])
    return row(tap.status.name, text)


def _tap(board: Board, tap: TapBoard, its: Score, width: int, glyphs: Glyphs) -> list[Text]:
    status = tap.status
    right, total = characters_right(board, tap)
    sure = f"first sure of a message at step {status.solved_k}" if status.solved_k >= 0 else ""
    heard = f"{count(status.steps)} steps, {count(status.lost)} of them with holes"
    if status.dropped:
        heard += f"; {count(status.dropped)} messages lost by the tap itself"
    follows = f"{count(status.behind)} steps behind"
    if status.candidates_left:
        follows += f", follows {count(status.candidates_left)} readings of what was sent"
    lines = [
        rule(glyphs, drawn(status.name), width),
        row("heard", Text(heard)),
        row(
            "keys",
            Text(
                f"{keys_right(its)} % of {its.scored} right; a key hides at most "
                f"{figure(its.bits_per_key)} bit from her"
            ),
        ),
        row("work", Text(follows)),
        row("message", Text(drawn(status.message)[: max(0, width - 18)])),
        row("", Text(f"{right} of {total} characters right, sure to {status.confidence:.2f}")),
    ]
    if sure:
        lines.append(row("", Text(sure)))
    if status.failed:
        lines.insert(1, row("FAILED", Text(drawn(status.failed), style=STYLES["bad"])))
    model = board.model
    for name in ("A", "B"):
        hers = getattr(status, name)
        true = getattr(model, name) if model is not None else ()
        for i, values in enumerate(hers):
            beside = true[i] if i < len(true) else ()
            told = "  ".join(component(v, "+") for v in values)
            truth = "  ".join(component(v, "+") for v in beside)
            label = f"her {name}, true {name}" if i == 0 else ""
            lines.append(row(label, Text(longest(width - 16, f"{told}   |  {truth}", told))))
    return lines
