"""The one interface of all eavesdroppers, and what they have in common.

An eavesdropper is handed a :class:`~protocol.knowledge.Knowledge` and then the transitions of the
public transcript, in order. For each she answers with a :class:`Guess`; at any time she says what
she believes of the message. Live and offline she is fed the same things by the same code.
"""

from abc import ABC, abstractmethod
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

from protocol.agreement import NO_SYMBOL, Gauge, predict
from protocol.errors import WynerError
from protocol.knowledge import Knowledge
from protocol.messages import FieldMessage
from protocol.messages.adversary import KeysHeld
from protocol.plugins import UnknownError
from protocol.schemes.base import Scheme, decrypt
from protocol.schemes.framing import Deframer
from protocol.schemes.registry import make_scheme, scheme_named
from protocol.vectors import Matrix, Vector
from tap_service.capture.transcript import Transition

if TYPE_CHECKING:
    from tap_service.inference.opening import Opening
    from tap_service.inference.output_model import OutputModel

KEPT_SYMBOLS: Final = 32768
"""Message symbols that a belief keeps, the newest."""

KEPT_MESSAGES: Final = 64
"""Whole messages that a belief keeps, the newest."""

IDLE_GUESS: Final = 0
"""Stands in for a message symbol whose cipher symbol was missed: the idle symbol."""


class KnowledgeError(WynerError):
    """An eavesdropper that is not told what it needs; the text names what is missing."""


MessageSymbols = Sequence[tuple[int, int]]
"""Steps, and the message symbol that each is taken to carry, oldest first."""


@dataclass(frozen=True, slots=True)
class Guess:
    """What an eavesdropper thinks of one transition, right after it.

    Parameters
    ----------
    k : int
        The transition's step.
    symbol : tuple of float, shape (M,)
        The probability of each candidate to be the applied one.
    agreed : float
        The probability that a key symbol was agreed here.
    session : str
        In second thoughts the transition's session; empty for that of the newest one.
    """

    k: int
    symbol: Vector
    agreed: float
    session: str = ""

    @property
    def best(self) -> int:
        """The likeliest symbol, the smallest index among equals."""
        return self.symbol.index(max(self.symbol))


@dataclass(frozen=True, slots=True)
class Belief:
    """What an eavesdropper thinks of the message so far.

    Parameters
    ----------
    message : bytes
        Her best message: the last whole one, or what there is of the one under way.
    whole : tuple of bytes
        The last messages whose frame check held, oldest first.
    whole_count : int
        How many there were in all.
    confidence : float
        How sure she is of ``message``, 0 to 1.
    candidates_left : int
        Candidate messages that remain; 0 where they are not counted.
    solved_k : int
        The step at which she was first sure of a whole message; -1 not yet.
    A, B : tuple of tuple of float
        The model she uses; empty when she has none.
    bits_left : float, optional
        Entropy of the message given all that she heard, in bits, where she computes it. It stands
        beside what her guesses are measured to leave, and the less counts.
    given : str
        Which kind of text she takes the message for, where she computes that, as ``German``: the
        entropy rests on what she expects of that kind.
    keys : KeysHeld, optional
        What she holds of the keys, where she attacks them.
    """

    message: bytes = b""
    whole: tuple[bytes, ...] = ()
    whole_count: int = 0
    confidence: float = 0.0
    candidates_left: int = 0
    solved_k: int = -1
    A: Matrix = ()
    B: Matrix = ()
    bits_left: float | None = None
    given: str = ""
    keys: KeysHeld | None = None

    def read_of(self, messages: Sequence[bytes]) -> tuple[int, int]:
        """How many of the messages she had whole, and of how many that can be told.

        She keeps the last of hers alone, so they stand beside as many of the last messages.
        """
        if self.whole_count > len(self.whole):
            messages = messages[-len(self.whole) :]
        return (Counter(messages) & Counter(self.whole)).total(), len(messages)


class Eavesdropper(ABC):
    """Base of all eavesdroppers.

    A subclass sets ``name``, and ``heavy`` when one transition may cost her more than some
    microseconds: she then works from the capture in a process beside the mirror, on a bounded share
    of a core, with the other heavy ones, and the mirror never waits for her. One with ``told_model
    = False`` is told neither f_c nor D_e, unless the model she is told is wrong on purpose. One
    with ``hears_messages`` is handed every message besides, right before the transitions that it
    finishes. One with ``guesses = False`` goes for something else than the loop's own symbols: what
    she answers for a transition is no guess, and she is not scored by it. One with ``reads_outputs
    = False`` wants whole states, and cannot listen where a plant is read through some outputs
    alone. One with ``corrects`` follows a scheme that corrects words, and guesses at the keys that
    come of them.

    Attributes
    ----------
    scheme : Scheme
        What both ends follow: she may know every algorithm, and no threshold and no key.
    certain : bool
        Whether the policy that she was told makes every transition agree.
    final_guesses : list of Guess
        Last thoughts on transitions that she lets go, because she keeps a bounded number of them.
        Whoever feeds her takes them off.

    Raises
    ------
    KnowledgeError
        From the constructor, when she needs more than she is told.
    """

    name: ClassVar[str]
    heavy: ClassVar[bool] = False
    told_model: ClassVar[bool] = True
    hears_messages: ClassVar[bool] = False
    guesses: ClassVar[bool] = True
    reads_outputs: ClassVar[bool] = True
    corrects: ClassVar[bool] = False

    def __init__(self, knowledge: Knowledge) -> None:
        self.knowledge = knowledge
        self.size = knowledge.candidates
        try:
            self.scheme = make_scheme(knowledge.scheme, knowledge.candidates)
            self.suits(knowledge)
        except UnknownError as error:
            raise KnowledgeError(f"knowledge.scheme: {error}") from None
        self.certain = knowledge.policy is not None and knowledge.policy.certain
        self.final_guesses: list[Guess] = []

    @classmethod
    def suits(cls, knowledge: Knowledge) -> None:
        """Whether she can listen to such a plant at all.

        Raises
        ------
        KnowledgeError
            Where some outputs alone are read, and she wants whole states; where the scheme corrects
            words, and she does not.
        """
        if scheme_named(knowledge.scheme).corrects and cls.guesses and not cls.corrects:
            raise KnowledgeError(
                f"{cls.name}: does not follow a scheme that corrects words ({knowledge.scheme}); "
                "set-membership, nearest-centre and oracle do"
            )
        if knowledge.C is not None and not cls.reads_outputs:
            raise KnowledgeError(
                f"{cls.name}: wants whole states, and this plant is read through "
                "some outputs alone (plant.C)"
            )

    def hear(self, message: FieldMessage) -> None:  # noqa: B027
        """Take a message as it was heard, repeats included."""

    @abstractmethod
    def observe(self, transition: Transition) -> Guess:
        """Take the next transition; her guess of it with what she knows by now."""

    @abstractmethod
    def belief(self) -> Belief:
        """Her best message by now. May be costly; it is asked for at a bounded rate."""

    def message_symbols(self) -> MessageSymbols:
        """Those of the transitions that she takes for a message's, the newest `KEPT_SYMBOLS`.

        None by default. They are many: she is asked for them once, after her second thoughts
        (:meth:`review`) and her last belief.
        """
        return ()

    def review(self) -> Sequence[Guess]:
        """Second thoughts on the transitions that she keeps; none by default."""
        return ()


def even(size: int) -> Vector:
    """The uniform distribution over ``size`` symbols."""
    return (1.0 / size,) * size


@dataclass(frozen=True, slots=True)
class Model:
    """Her f_c and the shape of her disturbance set: enough to measure every candidate.

    Parameters
    ----------
    A, B : tuple of tuple of float, shapes (n, n) and (n, m)
    gauge : Gauge
        The gauge of D_e, in units of D_e: membership in Reach^e is a value of at most 1.
    """

    A: Matrix
    B: Matrix
    gauge: Gauge

    settled: ClassVar[bool] = True
    """Whole states need no time to be known."""

    @classmethod
    def of(cls, knowledge: Knowledge, needed_by: str) -> "Model | OutputModel":
        """The model in ``knowledge``, for what is read of the plant.

        Raises
        ------
        KnowledgeError
            When a part of it is not known.
        """
        k = knowledge
        missing = [f for f in ("A", "B", "disturbance_H", "disturbance_h") if getattr(k, f) is None]
        if missing:
            raise KnowledgeError(
                f"{needed_by}: knowledge lacks {', '.join(missing)}, expected a model"
            )
        assert k.A is not None
        assert k.B is not None
        assert k.disturbance_H is not None
        assert k.disturbance_h is not None
        gauge = Gauge.from_rows(k.disturbance_H, k.disturbance_h)
        if k.C is None:
            return cls(k.A, k.B, gauge)
        from tap_service.inference.output_model import OutputModel

        assert gauge.half_widths is not None, "a box, where outputs are read"
        gain = None if k.policy is None else k.policy.gain
        return OutputModel(k.A, k.B, k.C, gauge.half_widths, noise=k.noise, gain=gain)

    def gauges(
        self,
        x: Sequence[float],
        candidates: Sequence[Sequence[float]],
        x_next: Sequence[float],
        predictions: Sequence[Sequence[float]] = (),
    ) -> list[float]:
        """g(x_next - c_i) for each candidate, in units of D_e; c_i as offered, if it was."""
        return [
            self.gauge([a - b for a, b in zip(x_next, centre, strict=True)])
            for centre in predictions or [predict(self.A, self.B, x, u) for u in candidates]
        ]

    def along_the_widest(
        self,
        x: Sequence[float],
        candidates: Sequence[Sequence[float]],
        x_next: Sequence[float],
        predictions: Sequence[Sequence[float]] = (),
    ) -> list[float]:
        """The same along one row of D_e, that along which the candidates lie farthest apart.

        Where sensors are noisy W has another shape than D_c, and what the other rows say is noise.
        """
        predictions = predictions or [predict(self.A, self.B, x, u) for u in candidates]
        widths = self.gauge.half_widths
        H, h = self.gauge.H, self.gauge.h
        if widths is not None:
            n = len(widths)
            H = tuple(tuple(1.0 if j == i else 0.0 for j in range(n)) for i in range(n))
            h = widths
        places = [
            [sum(a * v for a, v in zip(row, c, strict=True)) / b for c in predictions]
            for row, b in zip(H, h, strict=True)
        ]
        r = max(range(len(places)), key=lambda i: max(places[i]) - min(places[i]))
        at = sum(a * v for a, v in zip(H[r], x_next, strict=True)) / h[r]
        return [abs(at - place) for place in places[r]]


class Follower:
    """Follows the scheme on verdicts of her own, and collects the message symbols.

    Where the scheme says that a transition carried, its ciphertext symbol minus the key as she has
    it is a message symbol.
    """

    def __init__(self, scheme: Scheme[Any]) -> None:
        self._scheme = scheme
        self._state = scheme.initial
        self._steps = array("q")
        self._symbols = bytearray()
        self.whole: list[bytes] = []
        self.whole_count = 0
        self.solved_k = -1
        self._deframer = Deframer(scheme.alphabet)

    def restart(self) -> None:
        """A new session: the scheme and the frame from the start."""
        self._state = self._scheme.initial
        self._deframer.reset()

    @property
    def tests(self) -> bool:
        """Whether she takes the next transition for one that is tested."""
        return self._scheme.tests(self._state)

    def step(self, k: int, symbol: int, cipher: int | None) -> int:
        """Count one transition on which her test says ``symbol`` (or -1); the key that it gains."""
        state = self._state if cipher is None else self._scheme.hear(self._state, cipher)
        self._state, carry = self._scheme.advance(state, symbol)
        if carry.pad != NO_SYMBOL:
            self._carried(k, carry.pad, cipher)
        return carry.agreed

    def _carried(self, k: int, pad: int, cipher: int | None) -> None:
        value = IDLE_GUESS
        if cipher is not None:
            value = decrypt(cipher, pad, self._scheme.alphabet)
        self._steps.append(k)
        self._symbols.append(value)
        if len(self._steps) >= 2 * KEPT_SYMBOLS:
            del self._steps[:KEPT_SYMBOLS]
            del self._symbols[:KEPT_SYMBOLS]
        payload = self._deframer.push(value)
        if not payload:
            return
        self.whole.append(payload)
        del self.whole[:-KEPT_MESSAGES]
        self.whole_count += 1
        if self.solved_k < 0:
            self.solved_k = k

    def belief(self, model: "Model | OutputModel | None", confidence: float = 0.0) -> Belief:
        """What this way of following gives: certain once a frame check held."""
        partial = self._deframer.partial
        return Belief(
            message=self.whole[-1] if self.whole else partial,
            whole=tuple(self.whole),
            whole_count=self.whole_count,
            confidence=1.0 if self.whole else confidence,
            solved_k=self.solved_k,
            A=() if model is None else model.A,
            B=() if model is None else model.B,
        )

    def message_symbols(self) -> MessageSymbols:
        """The newest that she collected."""
        return [*zip(self._steps[-KEPT_SYMBOLS:], self._symbols[-KEPT_SYMBOLS:], strict=True)]


class Following(Eavesdropper):
    """A light one: a model, and a verdict of her own on every transition that she heard whole."""

    def __init__(self, knowledge: Knowledge) -> None:
        super().__init__(knowledge)
        self.model = Model.of(knowledge, self.name)
        self.even = even(self.size)
        self.follower = Follower(self.scheme)

    def observe(self, transition: Transition) -> Guess:
        """Follow the scheme; what was not heard whole is guessed evenly."""
        t = transition
        if t.start or t.gap:
            self.follower.restart()
        if t.x is None or t.candidates is None or t.x_next is None:
            self.follower.step(t.k, NO_SYMBOL, t.cipher)
            return Guess(t.k, self.even, 0.5)
        symbol, guess = self.judged(t, t.x, t.candidates, t.x_next)
        key = self.follower.step(t.k, symbol, t.cipher)
        if not self.scheme.corrects:
            return guess
        if key == NO_SYMBOL:
            return Guess(t.k, self.even, 0.0)
        return Guess(t.k, tuple(float(i == key) for i in range(self.size)), 1.0)

    @abstractmethod
    def judged(
        self, t: Transition, x: Vector, candidates: Sequence[Vector], x_next: Vector
    ) -> tuple[int, Guess]:
        """The key symbol that she follows the scheme with, or -1, and her guess."""

    def belief(self) -> Belief:
        """The message that her verdicts spell."""
        return self.follower.belief(self.model)

    def message_symbols(self) -> MessageSymbols:
        """What her verdicts make of the ciphertext."""
        return self.follower.message_symbols()


def opening_of(model: "Model | OutputModel", size: int, *, certain: bool) -> "Opening | None":
    """What holds a session's first transitions; None where states are read, or none agrees for
    sure."""
    if not certain or isinstance(model, Model):
        return None
    from tap_service.inference.opening import Opening

    return Opening(model, size)


def nearest(gauges: Sequence[float]) -> Vector:
    """All probability on the nearest candidate; shared among equals."""
    smallest = min(gauges)
    share = 1.0 / gauges.count(smallest)
    return tuple(share if g == smallest else 0.0 for g in gauges)
