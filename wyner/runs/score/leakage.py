"""A second opinion on P_g that knows no model of the secret: rows for estimators, and one of them.

Tools that measure leakage from examples alone, such as F-BLEAU (Cherubin and others, "F-BLEAU: fast
black-box leakage estimation", 2019), take rows of a secret and what is seen of it. Here the secret
is an agreed key symbol, and the view x(k+1) less each candidate's prediction: all that the public
transcript says of that symbol to one who knows f_c. The estimate here is theirs too: the share of
rows whose secret the nearest other rows name. It tends to P_g from below as rows are added.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from protocol.agreement import NO_SYMBOL, predict
from protocol.knowledge import Knowledge
from protocol.vectors import Vector
from tap_service.capture.reading import CaptureReader
from tap_service.capture.transcript import Transcript, Transition
from wyner.runs.score.score import Proportion, ScoreError
from wyner.runs.score.step_table import Truth

FEWEST = 20
"""Rows below which nothing is estimated."""


class LeakedKey(NamedTuple):
    """An agreed key symbol, and what the transcript shows of it: M n numbers."""

    secret: int
    view: Vector


def leaked_keys(reader: CaptureReader, truth: Truth) -> list[LeakedKey]:
    """One of each agreed transition that the tap heard whole.

    Parameters
    ----------
    reader : CaptureReader
    truth : Truth

    Raises
    ------
    ScoreError
        When the capture's header tells no model.
    """
    try:
        knowledge = Knowledge.model_validate(reader.header["knowledge"])
    except (KeyError, ValueError):
        raise ScoreError(f"{reader.path}: line 1: expected knowledge in the header") from None
    transcript = Transcript()
    out: list[LeakedKey] = []

    def take(t: Transition) -> None:
        secret = truth.of(t.session, t.k).get("key", NO_SYMBOL)
        if secret != NO_SYMBOL and t.whole:
            out.append(LeakedKey(secret, view_of(t, knowledge)))

    for _, message in reader.records():
        for transition in transcript.hear(message):
            take(transition)
    for transition in transcript.flush():
        take(transition)
    return out


def view_of(t: Transition, knowledge: Knowledge) -> Vector:
    """x(k+1) less each prediction, one after the other; of a transition that was heard whole."""
    assert t.x is not None
    assert t.candidates is not None
    assert t.x_next is not None
    predictions: Sequence[Sequence[float]] = t.predictions
    if not predictions:
        A, B, x = knowledge.A, knowledge.B, t.x
        if knowledge.C is not None:
            raise ScoreError("plant.C: expected none, as a view is made of whole states")
        if A is None or B is None:
            raise ScoreError("capture: expected a model, A and B, in what the tap was told")
        predictions = [predict(A, B, x, u) for u in t.candidates]
    return tuple(a - b for centre in predictions for a, b in zip(t.x_next, centre, strict=True))


def leakage_rows(keys: Sequence[LeakedKey]) -> Iterator[dict[str, Any]]:
    """The rows of a table: ``secret``, ``view_1``, ``view_2``, ..."""
    for key in keys:
        yield {
            "secret": key.secret,
            **{f"view_{i}": value for i, value in enumerate(key.view, start=1)},
        }


def neighbours_right(keys: Sequence[LeakedKey]) -> Proportion | None:
    """Secrets that the nearest other rows name, leave one out; None of too few rows, or all alike.

    The number of neighbours is odd and about the rows' logarithm, so that it grows while its share
    of the rows vanishes (Stone's theorem). Each number of a view is in units of its deviation.
    """
    if len(keys) < FEWEST:
        return None
    import numpy as np
    from scipy.spatial import cKDTree

    views = np.array([key.view for key in keys])
    secrets = np.array([key.secret for key in keys])
    spread = views.std(axis=0)
    if not (spread > 0).any():
        return None
    views = views[:, spread > 0] / spread[spread > 0]
    count = math.ceil(math.log(len(keys))) | 1
    _, near = cKDTree(views).query(views, k=count + 1)
    own = np.arange(len(keys))[:, None]
    # of equal views a row itself need not come first: it is taken out wherever it stands
    others = np.array([row[row != i][:count] for i, row in enumerate(np.asarray(near))])
    size = int(secrets.max()) + 1
    votes = np.zeros((len(keys), size))
    np.add.at(votes, (np.broadcast_to(own, others.shape), secrets[others]), 1.0)
    return Proportion(float((votes.argmax(axis=1) == secrets).sum()), len(keys))


def leakage_line(keys: Sequence[LeakedKey]) -> str:
    """The estimate in words."""
    found = neighbours_right(keys)
    if found is None or found.share is None:
        few = f"fewer than {FEWEST} rows, or views all alike"
        return f"P_g by nearest neighbours: not estimated from {few}"
    return (
        f"P_g by nearest neighbours, no model of the secret: {found.share:.4f} (no interval: one "
        "run, whose rows are each other's neighbours); it comes to P_g from below"
    )
