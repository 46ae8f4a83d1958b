"""One real end of the link as a state: endpoint and journal, and what it has done.

All that an end does next follows from itself and from what it hears: :meth:`End.do` is a function.
So that it is, every draw is named by what it is for (a nonce by its process, session and step), and
an end's clock stands at 0 before each event, all times being relative to it.

It is no :mod:`tests.support.pair`, whose partner is there: here each step of one end is made
once, without the other, and looked up afterwards.
"""

import base64
import hashlib
from functools import cache
from math import inf
from typing import Final, Literal, NamedTuple

from controller_service.core import ControllerCore
from plant_service.core import PlantCore
from protocol.agreement import NO_SYMBOL
from protocol.link.distiller import BlockEnded
from protocol.link.effects import (
    Effect,
    Effects,
    Extract,
    Notice,
    Publish,
    Save,
    Show,
    Tell,
)
from protocol.link.events import Event, SessionBegan
from protocol.link.session import SILENCE_S, CountedTransition, Rules
from protocol.link.step import Read
from protocol.messages import Measurement, Message, Offer
from protocol.secret.blocks import ClosedBlock, ExtractedBlock
from protocol.secret.extractor import extracted
from protocol.secret.nonces import NONCE_BYTES
from protocol.secret.stream import NOTHING_HELD, NOWHERE, Held, Position
from runtime import perform as shell
from runtime.journal import ControllerJournal, PlantJournal
from runtime.perform import Crashed, Crashing, CrashPoint
from tests.campaigns.loop import propose
from tests.support.journals import controller_journal, handed_over, plant_journal
from tests.support.line import (
    ActingLine,
    LineDevice,
    LinePlant,
    Reports,
    line_controller,
    line_plant,
)
from tests.support.mail import Mail, mail
from tests.support.once import honest
from tests.support.safety import first_held
from wyner.simulate.network import reported

Side = Literal["plant", "controller"]

PAYLOADS: Final = (b"",)
STEP_S: Final = 0.1
REPEATS: Final = 2
"""Measurements within a step while no offer comes: two, so that there is a copy 1."""

LONG_S: Final = 10.0
"""Longer than any silence after which an end does something else."""

JUST_NOW_S: Final = 0.001


class Doing(NamedTuple):
    """What may happen to one end.

    ``what`` it is: it ``hears`` a message (by number, with the plant's coin), it ``wakes`` when it
    is due, it ``extracts`` the next block and is told, it ``freezes`` longer than any silence, it
    ``dies``, or it ``forgets``: dies and comes back without its journal. ``pace`` is ``late`` when
    its partner has been silent for long, and ``soon`` when less than a tenth of a second has
    passed.
    ``death`` is the number of things that it still does before it dies over the event, or -1.
    """

    what: Literal["hears", "wakes", "extracts", "freezes", "dies", "forgets"]
    message: int = -1
    coin: int = 0
    pace: Literal["", "soon", "late"] = ""
    death: int = -1

    @property
    def faults(self) -> int:
        """How much of the budget of faults it takes."""
        return int(self.what in ("freezes", "dies", "forgets")) + (self.death >= 0)


class Taken(NamedTuple):
    """The digits that a step takes."""

    session: str = ""
    k: int = -1
    position: Position = NOWHERE

    def end(self, count: int) -> Position:
        """Position after its ``count`` digits."""
        return self.position._replace(at=self.position.at + count)


class View(NamedTuple):
    """What of an end its partner's deeds are compared with.

    The last two transitions that it has counted (an older one cannot be in doubt: the controller
    is behind by one at most), the session of its journal, with the newest blocks that it has
    announced and confirmed and the digits that it holds, the messages that arrived there, and
    whether it has lost its journal.
    """

    counted: tuple[CountedTransition, ...] = ()
    session: str | None = None
    announced: int = -1
    confirmed: int = -1
    held: Held = NOTHING_HELD
    received: int = 0
    forgot: bool = False


class End:
    """One end, alive; each step has a deadline, so that steps are missed.

    Parameters
    ----------
    side : {"plant", "controller"}
    rules : Rules
    acts : bool
        The plant is a device: its step is begun, and read when it ends.
    """

    def __init__(self, side: Side, rules: Rules, *, acts: bool = False) -> None:
        self.side: Side = side
        self.device = LineDevice() if acts and side == "plant" else None
        self.rules = rules
        self.now = 0.0
        self.lives = 0
        self.view = View()
        self.tasks: list[ClosedBlock] = []
        self._drawn = (-1, 0)  # a transition, and how often its cover was drawn in this life
        self._said: dict[str, Measurement | Offer] = {}
        self._first: dict[str, tuple[str, int]] = {}
        self._ciphers: tuple[tuple[str, int, int], ...] = ()
        self._taken = (Taken(), Taken(), Taken())  # by the newest steps that took any
        self.journal: ControllerJournal | PlantJournal
        if side == "controller":
            self.journal = controller_journal(*PAYLOADS)
        else:
            self.journal = plant_journal()
        self.endpoint: ControllerCore | PlantCore
        self.line: LinePlant | ActingLine | None = None
        self.mortal()
        self._begin_event()
        self._start()
        self._look()
        self._set_clock()

    def mortal(self) -> None:
        """It dies within what it asks of its shell, and of its device."""
        self._shell = Crashing(self._carry_out)
        if self.device is not None:
            self.device.passes = self._acts

    def _acts(self, point: CrashPoint) -> None:
        self._shell.passes(point)
        self.things += 1

    def _begin_event(self) -> None:
        self.out: list[Mail] = []
        self.news: list[CountedTransition] = []
        self.again = self.ended = self.confirmed = self.answered = self.watched = False
        self.things = 0
        self._nonces: list[str] = []
        self._reports = Reports()
        self._heard_k = -1

    # --- lives ------------------------------------------------------------------------------------

    def _start(self) -> None:
        self.lives += 1
        self.tasks.clear()
        self._drawn = (-1, 0)
        self.line = None
        self._starting = True
        instance = f"{self.lives:08x}{'c' if self.side == 'controller' else 'f'}{0:07x}"
        if isinstance(self.journal, ControllerJournal):
            self.endpoint = line_controller(
                self.rules, propose, self.journal, self, instance, self.nonce, LONG_S / 3
            )
        else:
            common = self.new_session, instance, self.now, STEP_S, self.nonce, REPEATS
            self.endpoint, self.line = line_plant(
                self.rules, self.journal, *common, device=self.device
            )
        self._perform(self.endpoint.start(self.now))
        self._starting = False

    def _perform(self, effects: Effects) -> None:
        shell.perform(effects, self._shell.do)

    def new_session(self) -> str:
        """An id that no other session has."""
        sessions = 0
        if self.line is not None:
            assert isinstance(self.endpoint, PlantCore)
            sessions = self.endpoint.state.record.session.sessions
        return f"{self.lives:08x}{sessions:08x}"

    def symbol(self, transition: int, size: int) -> int:
        """A cover symbol; a second decision of the same one would show."""
        last, count = self._drawn
        count = count + 1 if transition == last else 0
        self._drawn = (transition, count)
        return (transition + self.lives + count) % size

    def nonce(self) -> str:
        """A nonce that tells what it is for."""
        if self.side == "controller":
            assert isinstance(self.endpoint, ControllerCore)
            session, k = self.endpoint.state.record.session.id, self._heard_k
        else:
            assert isinstance(self.endpoint, PlantCore)
            record = self.endpoint.state.record
            session, k = record.session.id, record.link.k
        drawn = _nonce(f"{self.side} {self.lives} {session} {k} {len(self._nonces)}")
        self._nonces.append(drawn)
        return drawn

    # --- what it asks for -------------------------------------------------------------------------

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case Save():
                self._save(effect)
            case Publish(message):
                self._publish(message)
            case Tell(event):
                self._trace(event)
            case Extract(block):
                self._extract(block)
            case Notice():
                return  # nobody reads the log
            case Show(status):
                raise AssertionError(f"nobody asked for a status: {status}")
        self.things += 1

    def _save(self, save: Save) -> None:
        """Keep it; a message arrives once, and in its place."""
        self._reports.look(save)
        step, received = save.step, save.received
        if isinstance(step, Read) and step.report.keyed:
            self._take(step.offer.session, step.offer.k, step.offer.position)
        self.journal.save(save)
        if received is not None:
            place = self.view.received
            self.again = received in PAYLOADS[:place]
            if not self.again:
                assert PAYLOADS[place:][:1] == (received,), f"{received!r} was never sent"
                self.view = self.view._replace(received=place + 1)

    def _take(self, session: str, k: int, position: Position) -> None:
        """A step takes digits; they lie beyond those of all before it, and are always the same."""
        before = self._taken[-1]
        if (session, k) == (before.session, before.k):
            assert position == before.position, f"step {k} took digits at two positions"
        else:
            free = session != before.session or position >= before.end(self.rules.digits)
            assert free, f"a digit at {position} is for two steps"
            self._taken = (*self._taken[1:], Taken(session, k, position))

    def _publish(self, message: Message) -> None:
        """Send it; a step's message says the same in each copy, and its copy 0 leaves once."""
        if isinstance(message, Measurement | Offer):
            message = self._said_before(message)
        self.out.append(mail(message))

    def _said_before(self, message: Measurement | Offer) -> Measurement | Offer:
        topic, at = message.topic, (message.session, message.k)
        dummy = ""
        if self.rules.schedule is not None and message.copy_number == 1:
            assert message.nonce in self._nonces, f"{topic} {message.k}: a nonce drawn before"
            dummy = DUMMY  # it means nothing to anybody, so one will do for all
        elif self.rules.schedule is not None:
            assert at != self._first.get(topic), f"{topic} {message.k}: copy 0 left twice"
            self._first[topic] = at
        plain = message.model_copy(update={"copy_number": 0, "nonce": ""})
        before = self._said.get(topic)
        if before is not None and before.session == message.session and before.k >= message.k:
            assert before.k == message.k, f"{topic} {message.k} was sent after {before.k}"
            assert before == plain, f"{topic} {message.k} was sent in two versions"
        self._said[topic] = plain
        if isinstance(message, Offer):
            self._offered(message)
            if (position := message.position) != NOWHERE:
                self._take(message.session, message.k, position)
        return message.model_copy(update={"nonce": dummy}) if dummy else message

    def _offered(self, offer: Offer) -> None:
        """No transition is offered two cipher symbols; those of the key stream change with it."""
        if self.rules.scheme.from_stream:
            return
        assert isinstance(self.endpoint, ControllerCore)
        j = reported(self.endpoint)
        for session, known, cipher in self._ciphers:
            if session == offer.session:
                assert j != known or cipher == offer.cipher, f"transition {j}: two ciphers"
                assert j >= known - 1, f"transition {j} was offered after transition {known}"
        this = (offer.session, j, offer.cipher)
        if this not in self._ciphers:
            self._ciphers = (*self._ciphers, this)[-2:]

    def _trace(self, event: Event) -> None:
        """Note what it has counted; a transition is counted in one version only, and in order."""
        if self.device is not None:
            self.device.look(event, alive=not self._starting)
        honest(event)
        if isinstance(event, BlockEnded):
            self.confirmed |= event.what == "confirmed"
        counted = self.view.counted
        if isinstance(event, SessionBegan) and counted:
            self.ended = event.session != counted[-1].session
        if not isinstance(event, CountedTransition):
            return
        mine = event.shared
        self.watched = event.expected != NO_SYMBOL
        self.news.append(mine)
        if mine in counted:
            return
        last = counted[-1] if counted and counted[-1].session == mine.session else None
        follows = 0 if last is None else last.j + 1
        assert mine.j == follows, f"transition {mine.j} was counted, and {follows} was not"
        window = 2 if self.side == "plant" else 1
        self.view = self.view._replace(counted=(*counted, mine)[-window:])

    def _extract(self, block: ClosedBlock) -> None:
        """A block waits to be extracted; a nonce counts once, and a copy 1's never."""
        nonces = {*block.nonces, base64.b64decode(DUMMY)}
        once = len(nonces) == block.counted + 1
        assert once, f"block {block.number} counts a nonce twice, or a copy 1's"
        self.tasks.append(block)

    # --- what may happen --------------------------------------------------------------------------

    def do(self, doing: Doing, kind: type[Message] | None = None, payload: bytes = b"") -> None:
        """Let it happen.

        Raises
        ------
        AssertionError
            When a safety property does not hold any more.
        """
        self._begin_event()
        self._shell.crash_at(after=doing.death)
        try:
            self._happens(doing, kind, payload)
        except Crashed:
            self._shell.crash_at()
            self._start()
        finally:
            self._shell.crash_at()
        self._look()
        self._set_clock()

    def _happens(self, doing: Doing, kind: type[Message] | None, payload: bytes) -> None:
        endpoint = self.endpoint
        if doing.what == "hears":
            assert kind is not None
            if isinstance(endpoint, ControllerCore):
                self._heard_k = _k_of(payload) if kind is Measurement else -1
                self.now += LONG_S if doing.pace == "late" else 0.0
                endpoint.state.session.greeting_at = inf if doing.pace == "soon" else -inf
            elif self.line is not None:
                self.line.coin, self.line.d = doing.coin, 0.3
            self._perform(endpoint.receive(kind, payload, self.now))
        elif doing.what == "wakes":
            if doing.pace == "late" and isinstance(endpoint, PlantCore):
                endpoint.state.session.answered_at = -SILENCE_S
            self.now = max(self.now, min(endpoint.wake_at(), self.now + LONG_S))
            self._perform(endpoint.wake(self.now))
        elif doing.what == "extracts":
            self._perform(endpoint.extracted(_extracted(self.tasks.pop(0))))
        elif doing.what == "freezes":
            self.now += LONG_S if self.line is None else SILENCE_S + 5 * STEP_S
        else:
            if doing.what == "forgets":
                self.journal.forget()
                if isinstance(self.journal, ControllerJournal):
                    handed_over(self.journal, PAYLOADS)
                if self.device is not None:
                    self.device.u = None  # what it was told is known to nobody any more
                self.view = self.view._replace(forgot=True)
            self._start()

    def _look(self) -> None:
        """What its journal holds of keys."""
        if self.rules.schedule is None:
            return
        loaded = self.journal.load()
        record = loaded.record
        if record is None:
            held = View()
        else:
            announced = record.keys.block
            held = View((), record.session.id, announced, record.keys.confirmed, loaded.held)
            served = self._taken[1 if self.side == "plant" else 0]  # with the save after the count
            over = served.end(self.rules.digits)
            gone = served.session != record.session.id or first_held(loaded.held) >= over
            assert gone, f"a digit that served step {served.k} is still in the journal"
        self.view = held._replace(
            counted=self.view.counted, received=self.view.received, forgot=self.view.forgot
        )

    def _set_clock(self) -> None:
        """The clock stands at 0 again; what is long past is past, and no more than that."""
        now, self.now, endpoint = self.now, 0.0, self.endpoint
        endpoint.state.now = 0.0
        if isinstance(endpoint, ControllerCore):
            away = now - endpoint.state.session.plant_at >= endpoint.state.session.running_s
            endpoint.state.session.plant_at = -inf if away else 0.0
            # a greeting that comes too soon after another and one that is lost are the same to all
            endpoint.state.session.greeting_at = -inf
            endpoint.chooser.stale_at = -inf
            return
        pacing = endpoint.state.pacing
        endpoint.state.session.hello_at = max(0.0, round(endpoint.state.session.hello_at - now, 6))
        silent = now - endpoint.state.session.answered_at >= SILENCE_S
        self.answered = endpoint.state.session.answered_at == now
        endpoint.state.session.answered_at = -SILENCE_S if silent else -JUST_NOW_S
        pacing.late_s, pacing.overruns = 0.0, 0
        pacing.deadline = round(pacing.deadline - now, 6)
        pacing.repeat_at = max(0.0, round(pacing.repeat_at - now, 6))


def _nonce(name: str) -> str:
    return base64.b64encode(
        hashlib.blake2b(name.encode(), digest_size=NONCE_BYTES).digest()
    ).decode()


DUMMY: Final = _nonce("dummy")


@cache
def _extracted(block: ClosedBlock) -> ExtractedBlock:
    """Its keys, worked out once."""
    return extracted(block)


def _k_of(payload: bytes) -> int:
    return Measurement.model_validate_json(payload).k
