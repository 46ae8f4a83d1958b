"""Eavesdroppers on simulated runs: the classes that listen live, fed the same public messages."""

from binascii import b2a_base64
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from random import Random

from protocol.agreement import NO_SYMBOL
from protocol.errors import WynerError
from protocol.messages import FieldMessage, Measurement, Offer
from protocol.relabelling import known
from protocol.secret.nonces import NONCE_BYTES
from protocol.vectors import Vector
from runtime.errors import Failure
from tap_service.capture.transcript import Transition
from tap_service.eavesdroppers import ORACLE, Eavesdropper, KnowledgeError, sound
from tap_service.listening import sound_belief, sound_guess
from wyner.simulate.engine.link import Transfer, whole_messages
from wyner.simulate.engine.loop import Runs


@dataclass(frozen=True, slots=True)
class TapResult:
    """What one eavesdropper got of one run.

    Parameters
    ----------
    agreements : int
        Key symbols that were agreed; none for one who does not guess at them.
    right : int
        Of these, the ones that she named right at once.
    known : int
        Of these, the ones that she knew at once, up to one relabelling of the symbols for the run
        (:mod:`protocol.relabelling`).
    delivered : int
        Whole messages that the plant recovered; the last ones, where she keeps no more of hers.
    read : int
        Of these, the ones among her whole messages in the end. One that she read once counts once,
        however often the same text was sent.
    key_blocks, key_bits : int
        Blocks that made keys, and the bits of their rows that one who goes for keys can compute.
    """

    agreements: int
    right: int
    known: int
    delivered: int
    read: int
    key_blocks: int = 0
    key_bits: int = 0


def transcript(runs: Runs, link: Transfer, place: int) -> Iterator[Transition]:
    """The public transcript of run ``place`` of a simulation with a record, nothing lost.

    Raises
    ------
    ValueError
        When the simulation kept no record.
    """
    if runs.x is None or runs.candidates is None:
        raise ValueError("runs: expected a simulation with record=True")
    x = [tuple(v) for v in runs.x[:, :, place].tolist()]
    offers = runs.candidates[..., place].tolist()
    first = True
    for k, cipher in enumerate(link.cipher[:, place].tolist()):
        if runs.missed is not None and runs.missed[k, place]:
            continue
        candidates = tuple(tuple(u) for u in offers[k])
        yield Transition("simulated", k, x[k], candidates, cipher, x[k + 1], start=first)
        first = link.ended is not None and bool(link.ended[k, place])


def public_messages(
    runs: Runs, link: Transfer, place: int, session: str
) -> Iterator[Measurement | Offer]:
    """A measurement a step, and an offer unless the plant misses the step; one more measurement.

    Raises
    ------
    ValueError
        When the simulation kept no record.
    """
    made = {t.k: t for t in transcript(runs, link, place)}
    assert runs.x is not None
    x: list[Vector] = [tuple(row) for row in runs.x[:, :, place].tolist()]
    applied, after = -1, x[0]
    for k, now in enumerate(x):
        yield Measurement.model_construct(
            session=session, k=k, x=now, applied_k=applied, x_after=after
        )
        t = made.get(k)
        if t is None:
            continue
        assert t.candidates is not None
        assert t.cipher is not None
        assert t.x_next is not None
        yield Offer.model_construct(session=session, k=k, candidates=t.candidates, cipher=t.cipher)
        applied, after = k, t.x_next


def copies(t: Transition, draw: Random, loss: float) -> Iterator[FieldMessage]:
    """Copies 0 of a step that a tap hears, each missed with probability ``loss``."""
    assert t.x is not None
    assert t.candidates is not None
    assert t.cipher is not None

    def nonce() -> str:
        return b2a_base64(draw.randbytes(NONCE_BYTES), newline=False).decode()

    both: tuple[FieldMessage, ...] = (
        Measurement.model_construct(
            session=t.session, k=t.k, x=t.x, applied_k=t.k - 1, x_after=t.x, nonce=nonce()
        ),
        Offer.model_construct(
            session=t.session, k=t.k, candidates=t.candidates, cipher=t.cipher, nonce=nonce()
        ),
    )
    return (message for message in both if draw.random() >= loss)


class EavesdropperError(Failure, WynerError):
    """An eavesdropper raised, or gave an answer that is none; one line that names it."""


@contextmanager
def _told_of(name: str, where: str) -> Iterator[None]:
    """Turn whatever an eavesdropper raises into one line that names it."""
    try:
        yield
    except KnowledgeError:
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise EavesdropperError(f"eavesdropper {name}: {where}: {what}") from error


def listen(
    runs: Runs, link: Transfer, names: Sequence[str | type[Eavesdropper]], place: int
) -> list[TapResult]:
    """Let each named eavesdropper hear run ``place``, and score her against the truth.

    Nothing is lost; but of the nonces' copies, which the engine does not send, one who goes for
    keys is given her own draw, and misses as many as the scenario's ``tap.loss`` says.

    Parameters
    ----------
    runs : Runs
        With a record.
    link : Transfer
        Of the same runs.
    names : sequence of str or class
        As ``wyner tap --eavesdropper`` takes them, or classes of one's own.
    place : int

    Raises
    ------
    EavesdropperError
        When one raises, or gives an answer that is none.
    """
    scenario = runs.scenario
    classes = [sound(name) for name in names]
    shown = [name if isinstance(name, str) else name.name for name in names]
    taps = []
    for name, kind in zip(shown, classes, strict=True):
        with _told_of(name, "knowledge"):
            told = scenario.oracle_knowledge() if kind.name == ORACLE else scenario.knowledge()
            taps.append(kind(told))
    attackers = [(name, tap) for name, tap in zip(shown, taps, strict=True) if tap.hears_messages]
    draw = Random(f"copies {runs.seed} {runs.runs[place]}")
    keys = link.agreed[:, place].tolist()
    pairs = [Counter[tuple[int, int]]() for _ in taps]
    for transition in transcript(runs, link, place):
        key = keys[transition.k]
        for message in copies(transition, draw, scenario.tap.loss) if attackers else ():
            for name, tap in attackers:
                with _told_of(name, "a message"):
                    tap.hear(message)
        for i, tap in enumerate(taps):
            where = f"step {transition.k}"
            with _told_of(shown[i], where):
                guess = tap.observe(transition)
            with _told_of(shown[i], where):
                guess = sound_guess(guess, scenario.secrecy.candidates)
            if tap.guesses and key != NO_SYMBOL:
                pairs[i][guess.best, key] += 1
    symbols = link.message_symbol[:, place].tolist()
    messages = whole_messages(symbols, scenario.secrecy.candidates)
    agreements = sum(key != NO_SYMBOL for key in keys)
    out = []
    for name, tap, steps in zip(shown, taps, pairs, strict=True):
        its = known([steps], scenario.secrecy.candidates)
        with _told_of(name, "belief"):
            belief = tap.belief()
        with _told_of(name, "belief"):
            belief = sound_belief(belief)
        read, of = belief.read_of(messages)
        held = (0, 0) if belief.keys is None else (belief.keys.blocks, belief.keys.bits)
        agreed = agreements if tap.guesses else 0
        out.append(TapResult(agreed, its.named, its.right, of, read, *held))
    return out
