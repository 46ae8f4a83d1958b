"""What the tap sees of the field bus, and how well: knobs apart from what the loop itself loses.

They are applied before the capture is written, so that a replay of it sees what was seen live. The
capture's header says which.
"""

import random
from collections import deque
from collections.abc import Iterator

from pydantic import ConfigDict

from protocol.fates import Fates
from protocol.knowledge import Delay, Direction, Knowledge, NotNegative
from protocol.losses import Losses
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.vectors import Matrix, Vector


class View(Losses):
    """Knobs of what the tap sees.

    Parameters
    ----------
    view : str
        Which direction: ``both``, ``measurements`` or ``offers``.
    loss, loss_bad, to_bad, to_good : float
        Probability that she misses a message: each for itself, or in bursts.
    noise : float
        Standard deviation of the Gaussian noise on every number of a state or an input.
    quantise : float
        Step to which these numbers are rounded; 0 leaves them as they are.
    delay : int
        Messages by which everything reaches her late.
    model_error : float
        Relative error of every entry of A and B in what she is told, with random sign.
    seed : int
        Of the draws of all these.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    view: Direction = "both"
    noise: NotNegative = 0.0
    quantise: NotNegative = 0.0
    delay: Delay = 0
    model_error: NotNegative = 0.0
    seed: int = 0

    @property
    def clear(self) -> bool:
        """Whether every message passes as it is, at once."""
        blurs = self.noise or self.quantise
        return self.view == "both" and not (self.chain.mean or blurs or self.delay)

    @property
    def hears_all(self) -> bool:
        """Whether no message is lost on her link to the loop, however blurred or late it is."""
        return self.view == "both" and not self.chain.mean

    def knowledge(self, knowledge: Knowledge, *, model: bool = True) -> Knowledge:
        """``knowledge`` with the model error (the same seed gives the same), and her receiver's.

        Who is not to be told the ``model`` is told a wrong one, where there is an error, or none.
        """
        update: dict[str, object] = {"noise": self.noise, "quantise": self.quantise}
        if not model and not self.model_error:
            update |= dict.fromkeys(("A", "B", "disturbance_H", "disturbance_h", "policy"))
        knowledge = knowledge.model_copy(update=update)
        if not self.model_error:
            return knowledge
        draw = random.Random(f"model {self.seed}")

        def wrong(matrix: Matrix | None) -> Matrix | None:
            if matrix is None:
                return None
            e = self.model_error
            return tuple(tuple(v * (1 + draw.choice((-e, e))) for v in row) for row in matrix)

        return knowledge.model_copy(update={"A": wrong(knowledge.A), "B": wrong(knowledge.B)})


class WiretapChannel:
    """The tap's imperfect channel: decides which messages get through, and what becomes of them."""

    def __init__(self, view: View) -> None:
        self.view = view
        self._draw = random.Random(f"view {view.seed}")
        self._chain = view.chain
        self._fates = Fates(f"view {view.seed}")
        self._held: deque[tuple[int, FieldMessage]] = deque()

    def hear(self, t_ns: int, message: FieldMessage) -> Iterator[tuple[int, FieldMessage]]:
        """The messages that reach her now, this one or one that was held back, with their time."""
        view = self.view
        if view.view != "both" and (view.view == "measurements") != isinstance(
            message, Measurement
        ):
            return
        if self._misses(message):
            return
        if view.noise or view.quantise:
            message = self._blur(message)
        if not view.delay:
            yield t_ns, message
            return
        self._held.append((t_ns, message))
        if len(self._held) > view.delay:
            yield self._held.popleft()

    def _misses(self, message: FieldMessage) -> bool:
        """Whether it does not reach her."""
        loss = self._chain.loss_at(message.k, self._fates.of_step)
        return loss > 0 and self._draw.random() < loss

    def rest(self) -> Iterator[tuple[int, FieldMessage]]:
        """What was held back, when nothing more comes."""
        while self._held:
            yield self._held.popleft()

    def _blur(self, message: FieldMessage) -> FieldMessage:
        if isinstance(message, Offer):
            candidates = tuple(self._blurred(u) for u in message.candidates)
            return message.model_copy(update={"candidates": candidates})
        x = self._blurred(message.x)
        # the same number told twice in one message was read from one instrument
        after = x if message.x_after == message.x else self._blurred(message.x_after)
        return message.model_copy(update={"x": x, "x_after": after})

    def _blurred(self, vector: Vector) -> Vector:
        noise, step = self.view.noise, self.view.quantise
        if noise:
            vector = tuple(v + self._draw.gauss(0.0, noise) for v in vector)
        if step:
            vector = tuple(round(v / step) * step for v in vector)
        return vector
