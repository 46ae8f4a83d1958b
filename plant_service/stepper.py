"""A step of the plant: from an offer to a counted transition, or without one.

A step goes as in Fig. 5 of the paper, and in one order for every plant: an offer comes, it is
checked, the coin is tossed, the input is applied, the plant is read, what was read and what is said
are saved, the state is reported, and while the controller works on it the step is counted: both
ends judge it, advance the automaton, decrypt and take the symbol for a frame. Where a step acts on
something that cannot be put back, the coin is saved before the input is applied; a device is read
at the tick, and a model at once.
"""

from collections.abc import Callable
from typing import Literal

from plant_service.plant import Plant
from plant_service.state import PlantState
from plant_service.status import PlantTelemetry
from protocol.agreement import NO_SYMBOL
from protocol.link.effects import Effects, Extract, Notice, Publish, Tell
from protocol.link.events import Interrupted, Missed
from protocol.link.incoming import NOTHING_TAKEN
from protocol.link.key_events import block_notices
from protocol.link.records import AppliedRecord
from protocol.link.session import TrueStep
from protocol.link.step import IDLE, Begun, Read
from protocol.messages import Measurement, Offer
from protocol.streams import SymbolSource
from protocol.vectors import Vector


class Stepper:
    """Steps one plant, and counts its transitions.

    Parameters
    ----------
    state : PlantState
    news : PlantTelemetry
    plant : Plant
        What is stepped.
    coin : SymbolSource
        b_r; draw j belongs to transition j.
    fallback : callable
        (x, u in force) to the input of a step without an offer.
    """

    def __init__(
        self,
        state: PlantState,
        news: PlantTelemetry,
        plant: Plant,
        coin: SymbolSource,
        fallback: Callable[[Vector, Vector], Vector],
    ) -> None:
        self.state, self.news = state, news
        self.plant, self.coin = plant, coin
        self._fallback = fallback
        self._left = True  # copy 0 of the newest measurement may have left
        self._latest_late_k = -1

    def forget(self) -> None:
        """A session begins: copy 0 of this step's measurement may have left in the one before."""
        self._left = True

    # --- an offer: check, coin, begin -------------------------------------------------------------

    def wrong(self, offer: Offer) -> str:
        """What is wrong with an offer's shape or candidates; nothing where it is well-formed."""
        rules = self.state.rules
        if len(offer.candidates) != rules.size:
            return f"offer.candidates: got {len(offer.candidates)}, expected {rules.size}"
        for u in offer.candidates:
            if len(u) != rules.inputs:
                return f"offer.candidates: expected {rules.inputs} inputs in each"
            if not rules.admissible(u):
                return "offer.candidates: expected inputs in U"
        if offer.cipher >= rules.size:
            return f"offer.cipher: got {offer.cipher}, expected below {rules.size}"
        return rules.malformed_predictions(offer.predictions) or rules.malformed_digits(
            "offer.stream_block", offer.stream_block, offer.stream_at
        )

    def place(self, offer: Offer) -> Literal["current", "stale", "foreign"]:
        """Whether an offer is for this session and this step (rule 5)."""
        if offer.session != self.state.session.record.id:
            return "foreign"
        return "current" if offer.k == self.state.link.k else "stale"

    def offered(self, offer: Offer) -> Effects:
        """If the offer is for this step: toss the coin, and begin."""
        state, rules = self.state, self.state.rules
        k, now = state.link.k, state.now
        place = self.place(offer)
        if place != "foreign":
            state.session.answered_at = now
        if place == "stale" and max(state.link.applied_k, self._latest_late_k) < offer.k < k:
            # Its step was missed. (An answer to a repeated measurement, whose step was made, is
            # not late; nor is it late twice.)
            self._latest_late_k = offer.k
            state.pacing.answered_late()
            self.news.late += 1
        if place != "current" or state.pacing.waiting:
            return
        self.news.answered(k, now)
        state.keys.compare(offer)  # first: it may confirm the block of the offer's digits
        digits = state.digits(offer.position)
        if state.keys.on and not digits and state.keys.awaits(offer.position.block):
            return  # the offer comes again, when its digits are there
        keyed = rules.keyed and digits
        coin = digits[0] if keyed else self.coin.symbol(state.link.transitions, rules.size)
        state.step = step = Begun(offer, coin)
        if self.plant.acts:  # that cannot be undone
            yield state.save()
        self.plant.begin(k, state.link.x, offer.candidates[coin])
        if state.pacing.timed:
            self.news.punctuality.acted(state.pacing.since_tick_s(now))
        state.pacing.applied()
        state.watchdog.applied(now)
        if not (self.plant.acts and state.pacing.waiting):
            yield from self.read(step, digits)

    # --- read, save, report -----------------------------------------------------------------------

    def read(self, step: Begun, digits: tuple[int, ...]) -> Effects:
        """The step is over: read the plant, save what is said of it, report it, and count it.

        A step whose session has ended while the plant acted counts in neither, and is missed.

        Parameters
        ----------
        step : Begun
        digits : tuple of int
            Those of the key stream that its offer names, as the state holds them now.
        """
        state, offer, k = self.state, step.offer, self.state.link.k
        x_next = self.plant.end(k)
        if offer.session != state.session.record.id:
            yield Tell(self.interrupted(x_next, sure=True))
            yield state.save()
            return
        block, tag = state.keys.announcement()
        report = Measurement(
            session=offer.session,
            k=k + 1,
            x=x_next,
            applied_k=k,
            x_after=x_next,
            copy_number=state.keys.copy(),
            nonce=state.keys.nonce(),
            applied_copy=offer.copy_number,
            block=block,
            tag=tag,
            keyed=bool(digits) if self.state.rules.digits else None,
        )
        state.step = read = Read(offer, step.coin, report)
        self._left = due = state.session.accepted and state.pacing.measurement_due(state.now)
        # By a frame's last report the controller takes the message for delivered.
        scheme = self.state.rules.scheme
        carried = bool(digits) if scheme.from_stream else scheme.pad(state.link.state) >= 0
        yield state.save(durable=state.frame.deframer.lacks_one and carried)
        if due:
            self.news.measured(k + 1, state.now)
            yield Publish(report)
        yield from self.count(read, digits)

    def measurement(self) -> Measurement:
        """Measurement(k): the state, the last applied offer and what came right after it.

        The first one of a step is its copy 0 and must leave; each one after it is another copy.
        """
        state, link, applied = self.state, self.state.link, self.state.applied
        again = (self._left or bool(state.keys.crowded)) and state.keys.on
        self._left = True
        self.news.measured(link.k, state.now)
        return Measurement(
            session=state.session.record.id,
            k=link.k,
            x=link.x,
            applied_k=link.applied_k,
            x_after=applied.x_after,
            copy_number=1 if again else 0,
            nonce=state.keys.nonce() if again else link.nonce,
            applied_copy=applied.copy,
            block=state.keys.record.block,
            tag=state.keys.record.tag,
            keyed=applied.keyed if self.state.rules.digits else None,
        )

    # --- count: judge, advance the automaton, decrypt, deframe ------------------------------------

    def count(self, step: Read, digits: tuple[int, ...]) -> Effects:
        """Count the transition that the step made, in which these ``digits`` have served.

        The key is what the test returns, as for the controller; the coin is only compared with it.
        (Where words are corrected it is of the coins, and they are compared as words.)
        """
        state, rules, before = self.state, self.state.rules, self.state.link
        offer, coin, report = step
        u, x_next = offer.candidates[coin], report.x
        counted = rules.count(before, offer, x_next, digits, coin)
        taken = NOTHING_TAKEN
        if counted.key != NO_SYMBOL:
            taken = state.frame.take(counted.message_symbol)
        truth = self.plant.truth
        transition = counted._replace(
            counts=state.keys.count(before, offer, offer.copy_number),
            coin=coin,
            u=u,
            truth=truth,
            recovered=taken.payload,
            refused=taken.refused,
        )
        state.step = IDLE
        state.link = counted.after.at(report.k, x_next, report.nonce)
        applied, differs = state.applied, counted.symbol not in (NO_SYMBOL, coin)
        state.applied = AppliedRecord(
            u,
            x_next,
            report.applied_copy,
            bool(report.keyed),
            applied.missed,
            applied.symbol_errors + (differs and not rules.scheme.corrects),
            applied.sensor_seed,
            self._state_of(truth),
        )
        state.session.on("offer applied")
        if digits:
            state.keys.used(offer.position, rules.digits)
        contradicted = self.news.counted(transition)
        ended = state.keys.ended()
        yield from map(Tell, ended)
        yield Tell(transition)
        if taken.symbols or taken.ended:  # else the next step saves the record
            yield state.save(taken.symbols, received=taken.payload)
        if state.keys.on:
            yield from map(Extract, state.keys.tasks())
        if taken.refused:
            yield Notice("a frame failed its check and was refused", "error")
        elif taken.payload is not None:
            self.news.last_message, self.news.message_k = taken.payload, offer.k
            self.news.soon(state.now)
            yield Notice(f"message recovered at step {offer.k}: {len(taken.payload)} bytes")
        if contradicted is not None:
            yield Notice(contradicted, "warning")
        if ended:
            yield from block_notices(state.keys, ended)

    # --- steps without an offer -------------------------------------------------------------------

    def miss(self) -> Effects:
        """No offer came in time (rule 4).

        A model makes the step under the fallback. A device has already made it, under the input in
        force; the fallback is applied for the step to come.
        """
        state, link, moved = self.state, self.state.link, self.state.moved
        u = state.applied.u
        if not self.plant.device:
            u = self._instead()
            self.plant.begin(link.k, link.x, u)
        x_next = self.plant.end(link.k)
        self._missed(u, x_next)
        self._fall_back(sure=True)
        if not moved:
            state.watchdog.moves(state.now)
        session, truth = state.session.record.id, self.plant.truth
        yield Tell(Missed(session, link.k, link.x, u, x_next, truth))
        yield state.save()

    def interrupted(self, x_next: Vector, *, sure: bool = False) -> Interrupted:
        """Count the step under way, which ends at ``x_next``, as a missed one.

        Parameters
        ----------
        x_next : tuple of float, shape (n,)
        sure : bool
            Whether the input chosen was applied; nobody knows after a death.
        """
        state, link, step = self.state, self.state.link, self.state.step
        candidates: tuple[Vector, ...] = ()
        u, coin = state.applied.u, NO_SYMBOL
        if isinstance(step, Begun):
            candidates, coin = step.offer.candidates, step.coin
            u = candidates[coin]
        self._missed(u, x_next)
        self._fall_back(sure=sure or not candidates)
        session, truth = state.session.record.id, self.plant.truth
        return Interrupted(session, link.k, link.x, u, x_next, candidates, coin, truth)

    def _instead(self) -> Vector:
        """The fallback's input for this step."""
        link, u, outputs = self.state.link, self.state.applied.u, self.state.rules.outputs
        if outputs is None:
            return self._fallback(link.x, u)
        return outputs.instead(link.estimate, link.k - link.applied_k - 1, u)

    def _state_of(self, truth: TrueStep | None) -> Vector:
        """The simulated state that the record keeps: where no reading tells it."""
        return () if self.state.rules.outputs is None or truth is None else truth.x_next

    def _missed(self, u: Vector, x_next: Vector) -> None:
        """Count a step without a transition, with ``u`` in force."""
        state = self.state
        state.keys.announcement()
        state.step = IDLE
        state.link = state.link.at(state.link.k + 1, x_next, state.keys.nonce())
        state.applied = state.applied._replace(
            u=u, missed=state.applied.missed + 1, true_x=self._state_of(self.plant.truth)
        )
        self._left = False

    def _fall_back(self, *, sure: bool) -> None:
        """Apply a device's fallback for the step to come, where it may not be in force already."""
        state, link = self.state, self.state.link
        if not self.plant.device:
            return
        following = self._fallback(link.x, state.applied.u)
        if not sure or following != state.applied.u:
            self.plant.begin(link.k, link.x, following)
            state.applied = state.applied._replace(u=following)
