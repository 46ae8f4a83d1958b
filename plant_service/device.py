"""A plant that acts: a device, or a simulation that cannot be put back where it was.

A step of it cannot be computed twice. So the coin is tossed and saved first, then the input is
applied, the plant is read when the step ends, and that is saved and reported. A process that dies
in between comes back to a step that is missed: never reported, so that neither end tests it, and
its ciphertext symbol goes out again. So is a step whose session ends before it is read.
"""

from collections.abc import Callable, Iterable

from plant_service.adapters.operated import Operated
from plant_service.peer import PlantPeer
from plant_service.plant import Move, Plant, PlantStep
from plant_service.status import PlantTelemetry
from protocol.link.events import Interrupted
from protocol.link.pacing import Pacing
from protocol.link.peer import NOTHING_TO_DO, Actions, Append, Outgoing, Save
from protocol.link.records import BegunStep, ReceiverRecord
from protocol.messages import Measurement, Message, Offer
from protocol.scenario import Scenario
from protocol.secret.nonces import Contribution
from protocol.streams import Stream, SymbolSource

Vector = tuple[float, ...]


class DevicePlant(Plant):
    """A plant that is actuated and read, with its coin and its receiver.

    Parameters
    ----------
    scenario, instance, coin, noise, record, chunks, raws, said
        As of :class:`plant_service.plant.Plant`.
    operated : Operated
        Started already; its last reading is the record's x, or that of a plant that is back.
    """

    def __init__(
        self,
        scenario: Scenario,
        instance: str,
        coin: SymbolSource,
        noise: Stream,
        record: ReceiverRecord,
        chunks: str,
        contributions: Iterable[Contribution],
        said: Measurement | None,
        operated: Operated,
    ) -> None:
        super().__init__(scenario, instance, coin, noise, record, chunks, contributions, said)
        self.operated = operated
        self._enters = scenario.plant.disturbance.enters or "state"

    def toss(self) -> int:
        """b_r of the transition to come."""
        return self._coin.symbol(self.receiver.record.transitions, self._size)

    def actuate(self, u: Vector) -> None:
        """Apply ``u`` now.

        Raises
        ------
        PlantError
        """
        d = self._disturbance(self.receiver.record.k) if self._enters == "input" else None
        self.operated.apply(u, d)

    def read(self) -> Vector:
        """x(k+1), at the end of the step.

        Raises
        ------
        PlantError
        """
        d = self._disturbance(self.receiver.record.k) if self._enters == "state" else None
        return self.operated.sample(d)

    def count(self, move: Move) -> PlantStep:
        """Count the transition that ``move`` made."""
        record = self.receiver.record
        effects = self.receiver.applied(move.offer, move.coin, move.x_next)
        u = move.offer.candidates[move.coin]
        return PlantStep(record.k, record.x, u, move.x_next, move.coin, effects)

    def miss(self) -> PlantStep:
        """No offer came in time.

        A simulation makes the step under the fallback. A device has already made it, under the
        input in force; the fallback is applied for the step to come.
        """
        record = self.receiver.record
        if not self.operated.device:
            u = self._fallback.input(record.x, record.u)
            self.actuate(u)
            x_next = self.read()
            self.receiver.missed(u, x_next)
            return PlantStep(record.k, record.x, u, x_next, None, None)
        x_next = self.read()
        self.receiver.missed(record.u, x_next)
        self._fall_back()
        return PlantStep(record.k, record.x, record.u, x_next, None, None)

    def _fall_back(self, *, sure: bool = True) -> None:
        """Apply the fallback for the step to come, where it is not ``sure`` to be in force."""
        record = self.receiver.record
        following = self._fallback.input(record.x, record.u)
        if self.operated.device and not (sure and following == record.u):
            self.actuate(following)
            self.receiver.record = record._replace(u=following)

    def interrupted(
        self, begun: BegunStep | None, x_next: Vector, *, sure: bool = False
    ) -> Interrupted:
        """Count a step that ends at ``x_next`` as a missed one.

        Parameters
        ----------
        begun : BegunStep, optional
            What it had begun; None where nothing is known of it.
        x_next : tuple of float, shape (n,)
        sure : bool
            Whether the input chosen was applied; nobody knows after a death.
        """
        record = self.receiver.record
        candidates = () if begun is None else begun.offer.candidates
        coin = -1 if begun is None else begun.coin
        u = record.u if begun is None else candidates[coin]
        self.receiver.missed(u, x_next)
        self._fall_back(sure=sure or begun is None)
        return Interrupted(record.session, record.k, record.x, u, x_next, candidates, coin)

    def safe(self, why: str) -> None:
        """Send the plant to its safe state."""
        self.operated.safe(why)

    def close(self) -> str:
        """Let go of the plant; what its own code raised over it, or nothing."""
        return self.operated.close()


class DevicePeer(PlantPeer):
    """The plant's end of one loop, of a plant that acts.

    Parameters
    ----------
    plant : DrivenPlant
    pacing, new_id, now, pending, fresh, steps, news, watchdog_s
        As of :class:`plant_service.peer.PlantPeer`.
    begun : BegunStep, optional
        A step of the journal's that was begun and not read.
    back : tuple of float, optional
        What a plant that is back from the dead has read first; None of a new one.
    """

    def __init__(
        self,
        plant: DevicePlant,
        pacing: Pacing,
        new_id: Callable[[], str],
        now: float,
        *,
        pending: Move | None = None,
        begun: BegunStep | None = None,
        back: Vector | None = None,
        fresh: bool = False,
        steps: int | None = None,
        news: PlantTelemetry | None = None,
        watchdog_s: float | None = None,
    ) -> None:
        super().__init__(
            plant,
            pacing,
            new_id,
            now,
            pending=pending,
            fresh=fresh,
            steps=steps,
            news=news,
            watchdog_s=watchdog_s,
        )
        self._moved = self._moved or begun is not None
        self._begun, self._back = begun, back
        self._acting: tuple[bytes, Offer, int] | None = None
        self._applied = False

    @property
    def _between_steps(self) -> bool:
        return super()._between_steps and self._acting is None

    @property
    def _driven(self) -> DevicePlant:
        assert isinstance(self.plant, DevicePlant)
        return self.plant

    def start(self, now: float) -> Actions:
        """Count what the journal holds; the step under way when the process died is missed."""
        actions = super().start(now)
        return actions if actions.finish_step else self._resume(actions)

    def finish_step(self) -> Actions:
        """Apply what was saved; in lock-step read it at once; count what was read."""
        if self._acting is not None and not self._applied:
            _, offer, coin = self._acting
            self._driven.actuate(offer.candidates[coin])
            self._applied = True
            self._acted(self._now)
            return NOTHING_TO_DO if self._pacing.waiting else self._read()
        return self._resume(super().finish_step())

    def receive(self, kind: type[Message], payload: bytes, now: float) -> Actions:
        """An offer, or a word of the controller's; what it writes names the step under way."""
        actions = super().receive(kind, payload, now)
        write = actions.write
        if self._acting is None or not isinstance(write, Save):
            return actions
        assert isinstance(write.record, ReceiverRecord)
        _, offer, coin = self._acting
        record = write.record._replace(begun=BegunStep(offer, coin))
        return actions._replace(write=write._replace(record=record))

    def _resume(self, actions: Actions) -> Actions:
        if self._back is None:
            return actions
        event = self._driven.interrupted(self._begun, self._back)
        self._begun = self._back = None
        before = actions.write
        record = self._driven.receiver.record
        write = before._replace(record=record, later=False) if isinstance(before, Save) else None
        events = (*actions.events, event)
        return actions._replace(events=events, write=write or Save(record))

    def _apply(self, offer: Offer, payload: bytes, now: float) -> Actions:  # noqa: ARG002
        coin = self._driven.toss()
        self._acting, self._applied = (payload, offer, coin), False
        self._moved = True
        return Actions(write=Append(payload, b"", coin), finish_step=True)

    def _ended(self) -> Actions:
        assert self._acting is not None
        _, offer, coin = self._acting
        if offer.session == self._driven.receiver.record.session:
            return self._read()
        return self._abandon(BegunStep(offer, coin))

    def _abandon(self, begun: BegunStep) -> Actions:
        """The session ended while the plant acted: the step counts in neither, and is missed."""
        self._acting = None
        event = self._driven.interrupted(begun, self._driven.read(), sure=True)
        receiver = self._driven.receiver
        return Actions(
            (event,), Save(receiver.record, obsolete_rows=receiver.keying.obsolete_rows())
        )

    def _read(self) -> Actions:
        """The step is over: read the plant, save, report, and only then count."""
        assert self._acting is not None
        payload, offer, coin = self._acting
        self._acting = None
        x_next = self._driven.read()
        self._uncounted = Move(offer, coin, x_next)
        receiver = self._driven.receiver
        report = receiver.moved(offer, x_next).wire()
        due = receiver.accepted and self._pacing.measurement_due(self._now)
        if due:
            receiver.reported()
        return Actions(
            write=Append(payload, report, coin),
            publish=(Outgoing(Measurement, report),) if due else (),
            finish_step=True,
        )
