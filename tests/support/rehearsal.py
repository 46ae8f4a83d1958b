"""A scripted session: the statuses that services would publish, made without any of them.

For tests and for looking at the screen. Plant, agreement, automata and framing are the real rules;
the control law is a plain feedback with a second candidate beside it, and the taps' statuses are
made up from the truth. Nothing here measures anything.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from protocol.agreement import NO_SYMBOL, AgreementRule, Gauge, predict
from protocol.messages import (
    LATENCY_BOUNDS_S,
    ControllerStatus,
    PlantModel,
    PlantStatus,
    TapStatus,
)
from protocol.messages.adversary import BeliefStatus, TailGuess
from protocol.messages.management import PicturedStep, TailStep
from protocol.schemes.framing import IDLE, Deframer, encode_frame
from protocol.schemes.switched import Switched
from wyner.dashboard.model import Arrival

MESSAGE_TEXT: Final = "Close valve 7 at 14:05 and hold the level at 3.2 m until noon."
PERIOD_S: Final = 0.1
TAIL: Final = 64
MODEL_EVERY: Final = 10
"""Batches from one that has the model, and a status with the whole tail, to the next."""

SESSION: Final = "3f2a9c51d07be684"
STEP_NS: Final = 10_000_000
"""Wall time of a step: ten times real time."""


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What the scripted system is like.

    Parameters
    ----------
    A, B : matrices, shapes (n, n) and (n, m)
        The plant.
    half_widths : tuple of float, shape (n,)
        D_c, a box.
    gain : matrix, shape (m, n)
        K.
    alpha : float
        D_e = alpha D_c.
    """

    A: tuple[tuple[float, ...], ...] = ((1.0, 0.0975), (0.0, 0.9512))
    B: tuple[tuple[float, ...], ...] = ((0.0246,), (0.4877,))
    half_widths: tuple[float, ...] = (0.12, 0.12)
    gain: tuple[tuple[float, ...], ...] = ((-3.0, -1.5),)
    alpha: float = 8.0
    message: str = MESSAGE_TEXT
    seed: int = 7

    def arrivals(self, steps: int, every: int = 10) -> Iterator[list[Arrival]]:
        """Batches of statuses, one batch after each ``every`` steps, for ``steps`` steps."""
        draw = random.Random(self.seed)
        n, m = len(self.A), len(self.B[0])
        rows = [
            tuple(sign if j == i else 0.0 for j in range(n))
            for i in range(n)
            for sign in (1.0, -1.0)
        ]
        H, h = tuple(rows), tuple(w for w in self.half_widths for _ in range(2))
        rule = AgreementRule(self.A, self.B, Gauge.from_rows(H, h), self.alpha)
        model = PlantModel(
            scenario="rehearsal",
            law="sustained",
            pace="x10",
            seeded=True,
            period_s=PERIOD_S,
            alpha=self.alpha,
            defender_H=H,
            defender_h=h,
            A=self.A,
            B=self.B,
        )
        x: tuple[float, ...] = tuple(4.0 / (i + 1) * (-1) ** i for i in range(n))
        frame_symbols = encode_frame(self.message.encode(), 2)
        scheme = Switched(2)
        state, p, recovered = scheme.initial, 0, ""
        deframer = Deframer(2)
        agreements = messages = 0
        pictured: PicturedStep | None = None
        tail: list[TailStep] = []
        solved_k = -1

        for k in range(steps):
            quiet = [sum(g * v for g, v in zip(row, x, strict=True)) for row in self.gain]
            first = tuple(max(-6.0, min(6.0, v)) for v in quiet)
            offered = first, tuple(v + draw.uniform(0.1, 1.4) for v in first)
            coin = draw.randrange(2)
            draw.randrange(2)  # the cover
            centre = zip(predict(self.A, self.B, x, offered[coin]), self.half_widths, strict=True)
            x_next = tuple(c + draw.uniform(-w, w) * 0.83 for c, w in centre)
            verdict = rule.verdict(x, offered, x_next)
            m_p = frame_symbols[p] if p < len(frame_symbols) else IDLE
            tested = scheme.tests(state)
            state, (symbol, pad) = scheme.advance(state, verdict.symbol)
            agreements += symbol >= 0
            row = TailStep(k, x, "test" if pad == NO_SYMBOL else "message", symbol, coin)
            tail = [*tail, row][-TAIL:]
            if tested:
                gauges, inside = verdict.gauges, verdict.inside
                pictured = PicturedStep(k=k, gauges=gauges, symbol=verdict.symbol, inside=inside)
            if pad != NO_SYMBOL:
                p += 1
                whole = deframer.push(m_p)
                if whole is not None:
                    recovered, messages, solved_k = whole.decode(), messages + 1, k
            x = x_next
            if (k + 1) % every:
                continue
            t_ns = (k + 1) * STEP_NS
            partial = deframer.partial.decode("utf-8", "replace")
            with_model = (k + 1) // every % MODEL_EVERY == 1
            last = tail if with_model else tail[-max(8, 2 * every) :]
            step = {
                "k": k + 1,
                "x": x,
                "transitions": k + 1,
                "agreements": agreements,
                "symbols": p,
                "automaton": state.s,
            }
            frame = {"symbols": min(p, len(frame_symbols)), "length": len(frame_symbols)}
            common = {
                "seq": k,
                "t_ns": t_ns,
                "phase": "running",
                "malformed": 0,
                "session": SESSION,
            }
            plant = common | {
                "sessions": 1,
                "step": step | {"missed": 0, "symbol_errors": 0},
                "frame": frame | {"messages": messages, "message_k": solved_k, "refused": 0},
                "timing": {
                    "late": 0,
                    "rate_hz": 100.0,
                    "latency_counts": (0,) * (len(LATENCY_BOUNDS_S) + 1),
                },
                "secrets": {
                    "message": partial,
                    "last_message": recovered,
                    "pictured": pictured,
                    "tail": last,
                },
            }
            controller = common | {
                "set_index": max(0, 40 - k),
                "step": step | {"k": k},
                "frame": frame | {"delivered": messages, "queue": 0},
                "secrets": {"message": self.message},
            }
            text = recovered or partial
            yield [
                *([Arrival(t_ns, model)] if with_model else []),
                Arrival(t_ns, PlantStatus.model_validate(plant)),
                Arrival(t_ns, ControllerStatus.model_validate(controller)),
                *(
                    Arrival(t_ns, self._tap(name, k, t_ns, tail, text, solved_k, m))
                    for name in ("set-membership", "nearest-centre", "list-decoder")
                ),
            ]

    def _tap(
        self,
        name: str,
        k: int,
        t_ns: int,
        tail: list[TailStep],
        text: str,
        solved_k: int,
        m: int,
    ) -> TapStatus:
        wrong = random.Random(f"{self.seed} {name}")
        if name == "set-membership":
            guesses = tuple((row.coin + random.Random(row.k).randrange(2)) % 2 for row in tail)
            message = "".join(chr(wrong.randrange(33, 127)) for _ in text)
        else:
            guesses = tuple(row.coin for row in tail)
            message = text
        if name == "nearest-centre":
            spoilt = [wrong.random() < 0.15 for _ in self.message]
            message = "".join("·" if bad else c for c, bad in zip(text, spoilt, strict=False))
        sure = name == "list-decoder" and solved_k >= 0
        knows = name != "set-membership"
        probability = 0.98 if knows else 0.5
        return TapStatus(
            seq=k,
            t_ns=t_ns,
            name=name,
            steps=k,
            mirrored=2 * k,
            belief=BeliefStatus(
                message=message,
                confidence=1.0 if sure else 0.1,
                candidates_left=1 if sure else (k if name == "list-decoder" else 0),
                solved_k=solved_k if sure else -1,
                A=self.A if knows else (),
                B=tuple(tuple(1.03 * b for b in row[:m]) for row in self.B) if knows else (),
            ),
            tail=tuple(
                TailGuess(row.k, guess, probability, 0.5)
                for row, guess in zip(tail, guesses, strict=True)
            ),
        )
