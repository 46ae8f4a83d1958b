"""The message's clauses: what arrived, and that no key served twice."""

import base64
from bisect import bisect_left
from dataclasses import dataclass

from protocol.agreement import NO_SYMBOL
from protocol.schemes.framing import Deframer
from wyner.verify.clause import Tally, need, sides
from wyner.verify.evidence import Counted, Evidence, Side


def carried(ts: list[Counted]) -> list[Counted]:
    """The transitions that carried a message symbol."""
    return [t for t in ts if t.role == "message"]


def prefix(e: Evidence, tally: Tally) -> None:
    """The plant's message symbols are the controller's first ones."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    assert e.plant is not None
    assert e.controller is not None
    for session, ours in e.plant.sessions.items():
        recovered = carried(ours)
        sent = carried(e.controller.sessions.get(session, []))
        for r, s in zip(recovered, sent, strict=False):
            same = r.message_symbol == s.message_symbol
            text = f"symbol {r.p}: sent {s.message_symbol}, recovered {r.message_symbol}"
            tally.count(same, session, r.j, r.k, text)
        if not -1 <= len(sent) - len(recovered) <= 0:
            j, k = (recovered[-1].j, recovered[-1].k) if recovered else (-1, -1)
            tally.fail(session, j, k, f"recovered {len(recovered)} symbols of {len(sent)} sent")


@dataclass(frozen=True, slots=True)
class _Whole:
    """A frame that the plant's symbols add up to, and the transition that completed it."""

    payload: bytes
    intact: bool
    at: Counted


def _frames_of(side: Side, size: int) -> tuple[list[_Whole], int]:
    """Every frame of a plant's trace in order, and the symbols that belong to frames under way."""
    frames = []
    under_way = 0
    for ts in side.sessions.values():
        deframer = Deframer(size)
        for t in carried(ts):
            if not 0 <= t.message_symbol < size:
                continue  # the automata's clause says so
            frame = deframer.push(t.message_symbol)
            if frame is not None:
                frames.append(_Whole(frame.payload, frame.intact, t))
        under_way += len(deframer.symbols)
    return frames, under_way


def _payloads(side: Side, kind: str) -> list[bytes]:
    return [base64.b64decode(event["payload"]) for event in side.trace.of(kind)]


def frames(e: Evidence, tally: Tally) -> None:
    """The symbols add up to whole frames, and to what the plant reported."""
    if not need(tally, plant_trace=e.plant):
        return
    assert e.plant is not None
    frames, under_way = _frames_of(e.plant, e.rules.size)
    for f in frames:
        tally.count(f.intact, f.at.session, f.at.j, f.at.k, "a frame fails its check")
    for event in e.plant.trace.of("refused"):
        tally.fail(event["session"], -1, -1, "the plant refused a frame")
    # between the journal and the trace a kill may lose one event for each life of the process
    told, intact = _payloads(e.plant, "recovered"), [f for f in frames if f.intact]
    lives = sum(1 for _ in e.plant.trace.of("session"))
    place = 0
    for payload in told:
        found = next((i for i, f in enumerate(intact[place:], place) if f.payload == payload), None)
        if found is None:
            tally.fail("", -1, -1, f"recovered {payload!r}, which its symbols do not add up to")
            break
        place = found + 1
    if len(intact) - len(told) > lives:
        tally.fail("", -1, -1, f"{len(intact)} frames in the symbols, {len(told)} recovered")
    tally.note = f"{under_way} symbols of a frame under way"


def messages(e: Evidence, tally: Tally) -> None:
    """The recovered messages follow the queue."""
    if not need(tally, plant_trace=e.plant, controller_trace=e.controller):
        return
    assert e.plant is not None
    assert e.controller is not None
    queued: list[tuple[str, bytes]] = [
        (event["id"], base64.b64decode(event["payload"])) for event in e.controller.trace.of("sent")
    ]
    # a controller that lost its journal is handed its messages again: the queue begins anew there
    begins: set[int] = set()
    known: set[str] = set()
    for i, (name, _) in enumerate(queued):
        if name in known:
            begins.add(i)
            known.clear()
        known.add(name)
    frames, _ = _frames_of(e.plant, e.rules.size)
    place, session = -1, ""
    reached = set()
    for f in frames:
        if not f.intact:
            continue
        allowed = {place + 1} | {b for b in begins if b > place}
        if f.at.session != session and place >= 0:
            allowed.add(place)  # received, but the session ended before the controller knew
        fits = sorted(i for i in allowed if i < len(queued) and queued[i][1] == f.payload)
        text = f"recovered {f.payload!r}, which is not the next queued message"
        tally.count(bool(fits), f.at.session, f.at.j, f.at.k, text)
        if fits:
            place = fits[-1] if place in fits else fits[0]
            reached.add(place)
        session = f.at.session
    whole = [f.payload for f in frames if f.intact]
    for payload in _payloads(e.controller, "delivered"):
        if payload not in whole:
            tally.fail(
                "", -1, -1, f"{payload!r} counts as delivered, the plant has not recovered it"
            )
    tally.note = f"{len(reached)} of {len(queued)} queued messages arrived"


def one_time_pad(e: Evidence, tally: Tally) -> None:
    """Walk the keys: each is agreed once and used once."""
    for name, side in sides(e):
        for session, ts in side.sessions.items():
            unused: list[Counted] = []
            for t in ts:
                if t.role == "message":
                    own = next((a for a in unused if a.symbol == t.key), None)
                    text = f"{name}'s trace: a message symbol without a key of its own"
                    if own is None and unused:
                        agreed = ", ".join(f"{a.symbol} at {a.j}" for a in unused)
                        text = f"{name}'s trace: key {t.key}, unused were {agreed}"
                    tally.count(own is not None, session, t.j, t.k, text)
                    if own is not None:
                        unused.remove(own)
                    else:
                        unused.clear()
                if t.symbol != NO_SYMBOL:
                    unused.append(t)


def _transition_of(ks: list[int], k: int) -> int:
    """The transition that an offer for step k was made for: that of the first applied k' >= k."""
    return bisect_left(ks, k)


def one_cipher(e: Evidence, tally: Tally) -> None:
    """Every offer made for a transition carries the same cipher symbol."""
    for name, side in sides(e):
        for before, after in side.overwritten:
            same = (before.cipher, before.role, before.key) == (
                after.cipher,
                after.role,
                after.key,
            )
            text = f"{name}'s trace: written twice with ciphers {before.cipher} and {after.cipher}"
            tally.count(same, after.session, after.j, after.k, text)
    if e.wire is None or e.plant is None:
        tally.note = "without a capture and a plant's trace only what was written twice is compared"
        return
    ks = {session: [t.k for t in ts] for session, ts in e.plant.sessions.items()}
    decided = {(t.session, t.j): t.cipher for t in e.plant.transitions}
    again = 0
    for seen in e.wire.seen:
        if seen.topic != "offer" or seen.session not in ks:
            continue
        at = (seen.session, _transition_of(ks[seen.session], seen.k))
        again += seen.k not in ks[seen.session][at[1] : at[1] + 1]
        cipher = seen.message.get("cipher")
        expected = decided.setdefault(at, cipher if isinstance(cipher, int) else NO_SYMBOL)
        text = f"{seen.where}: cipher {cipher}, decided was {expected}"
        tally.count(cipher == expected, seen.session, at[1], seen.k, text)
    tally.note = f"{again} offers that were not applied carried the symbol of the next that was"
