"""A whole scenario: its tables, the model f_c and its fingerprints."""

import hashlib
import json
from collections.abc import Iterator
from functools import lru_cache
from math import isfinite
from typing import Annotated, Self

from pydantic import Field, SerializeAsAny, model_validator

from protocol.box_observer import Box, BoxObserver
from protocol.brief import Brief
from protocol.defence.alarm_rule import AlarmRule
from protocol.defence.watch import Watch
from protocol.knowledge import Knowledge
from protocol.plugins import source_of
from protocol.scenario.attack import AttackTable
from protocol.scenario.control import Control
from protocol.scenario.defence import DefenceTable, needs_keys
from protocol.scenario.defender import Defender
from protocol.scenario.keys import Keys
from protocol.scenario.kinds import by_kind, law_table, plant_table
from protocol.scenario.link import Link
from protocol.scenario.network import Network
from protocol.scenario.noise import widened
from protocol.scenario.parts import ScenarioTable, shape_problem
from protocol.scenario.plant import PlantTable
from protocol.scenario.secrecy import Secrecy
from protocol.scenario.sets import ConvexSet
from protocol.scenario.tap import TapView
from protocol.schemes.registry import make_scheme, scheme_named
from protocol.vectors import FiniteMatrix, FiniteVector

RULES_VERSION = 3
"""Version of agreement and framing together; part of the fingerprint, beside the scheme's own."""

DESIGN_VERSION = 3
"""Version of the synthesis; part of the key of a cached design."""


class Scenario(Brief, ScenarioTable):
    """One system: plant, defender's model, law, agreement rule, link, tap and keys."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
    """What the scenario is called: letters, digits, dots, dashes, underscores."""
    description: str = ""
    """One line for people."""
    source: str = ""
    """Where its numbers come from."""
    plant: SerializeAsAny[Annotated[PlantTable, by_kind("kind", "linear", plant_table)]]
    """What is simulated or driven."""
    defender: Defender
    """What both ends know of the plant, and Eve does not."""
    control: SerializeAsAny[Annotated[Control, by_kind("law", "sustained", law_table)]]
    """How the candidate inputs are computed."""
    secrecy: Secrecy
    """The agreement rule."""
    link: Link = Link()
    """What the ends do when the network does not serve them."""
    network: Network | None = None
    """What lies between the two ends; a perfect one where not given."""
    tap: TapView = TapView()
    """The eavesdropper's place."""
    keys: Keys | None = None
    """What the operator claims that Eve misses; distilled keys rest on it."""
    defence: DefenceTable = DefenceTable()
    """How the controller tests what it is told."""
    attack: AttackTable | None = None
    """Who lies about the plant, if anybody does."""

    def brief(self) -> dict[str, object]:
        """Name, sizes and what it runs under."""
        return {
            "name": self.name,
            "states": self.n,
            "inputs": self.m,
            "candidates": self.secrecy.candidates,
            "law": self.control.law,
            "scheme": self.secrecy.scheme,
            "alpha": self.secrecy.alpha,
            "period_s": self.plant.period_s,
        }

    @property
    def A(self) -> FiniteMatrix:
        """State matrix of the defender's model f_c, shape (n, n)."""
        A = self.defender.A or self.plant.A
        assert A is not None, "validated"
        return A

    @property
    def B(self) -> FiniteMatrix:
        """Input matrix of the defender's model f_c, shape (n, m)."""
        B = self.defender.B or self.plant.B
        assert B is not None, "validated"
        return B

    @property
    def plant_model(self) -> tuple[FiniteMatrix, FiniteMatrix]:
        """The plant's own A and B where it is linear, else the defender's."""
        return self.plant.A or self.A, self.plant.B or self.B

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.plant_model[0])

    @property
    def readings(self) -> int:
        """Numbers of a reading: n, or the rows of C."""
        return self.n if self.plant.C is None else len(self.plant.C)

    @property
    def digits(self) -> int:
        """Digits of the key stream that an offer takes: for the coin, and for a sealed symbol."""
        return self.defence.keyed + scheme_named(self.secrecy.scheme).from_stream

    @property
    def observer(self) -> BoxObserver | None:
        """The box observer of both ends; None where the whole state is read."""
        D_c, N = self.defender.disturbance.half_widths, self.defender.noise
        if self.plant.C is None or N is None:
            return None
        assert D_c is not None, "validated"
        assert N.half_widths is not None, "validated"
        assert self.defender.bounds is not None, "validated"
        return BoxObserver(self.A, self.B, self.plant.C, D_c, N.half_widths, self.defender.bounds)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.plant_model[1][0])

    @property
    def initial_state(self) -> FiniteVector:
        """x(0); zero, the operating point, where the plant starts as it stands."""
        return self.plant.initial_state or (0.0,) * self.n

    @property
    def cost_weights(self) -> tuple[FiniteVector, FiniteVector]:
        """Diagonals of Q and R, by which a loop is judged: x' Q x + u' R u a step.

        Those of ``control.performance``, else the regulator's, else ones.
        """
        weights = self.control.performance or self.control.regulator
        if weights is None:
            return (1.0,) * self.n, (1.0,) * self.m
        return weights.next_state, weights.input

    @property
    def control_set(self) -> ConvexSet:
        """What the sets T_i resist: ``control.disturbance``, else the least that they must."""
        return self.control.disturbance or self.resisted

    @property
    def resisted(self) -> ConvexSet:
        """The least that the sets must resist: the test's own set.

        Where outputs are read it is D_c + A E + E, for E the box of a loop whose every input is
        decoded: so far the estimate may move by itself.
        """
        observer = self.observer
        if observer is None:
            return self.test_set
        E = _quiet(observer)
        widths = []
        for row, own, d in zip(self.A, E, observer.disturbance, strict=True):
            total = d + own
            for a, e in zip(row, E, strict=True):
                total += abs(a) * e
            widths.append(total)
        return ConvexSet(half_widths=tuple(widths))

    @property
    def test_set(self) -> ConvexSet:
        """The defender's half of the test: D_c, or W = D_c + N + A N where sensors are noisy.

        Where outputs are read it is a strip, not bounded: abs(C v) at most rad(C A E + C D_c + N).
        """
        D_c, N = self.defender.disturbance, self.defender.noise
        observer = self.observer
        if observer is not None:
            E = _quiet(observer)
            reach = observer.reach(Box(tuple(-e for e in E), E))
            rows = [row for line in observer.C for row in (line, tuple(-c for c in line))]
            return ConvexSet(H=tuple(rows), h=tuple(r for r in reach for _ in range(2)))
        return D_c if N is None else widened(D_c, N, self.A)

    @property
    def eavesdropper_shape(self) -> ConvexSet:
        """D_e over alpha: ``secrecy.disturbance``, else D_c."""
        return self.secrecy.disturbance or self.defender.disturbance

    @property
    def eavesdropper_set(self) -> ConvexSet:
        """D_e, the disturbances that Eve finds possible (equation 10)."""
        return self.eavesdropper_shape.scaled(self.secrecy.alpha)

    @property
    def alarm_rule(self) -> AlarmRule:
        """When failed tests make an alarm."""
        return self.defence.rule(
            self.defender.calibration, self.plant.period_s, self.secrecy.candidates
        )

    @property
    def watch(self) -> Watch:
        """When unwatched steps make an alarm."""
        return self.defence.watch(self.keys)

    @property
    def hidden_widths(self) -> int:
        """Widths of D_c and N unknown to one who knows f_c and D_e: one where D_e = alpha D_c."""
        N = self.defender.noise
        if N is not None:
            return 1 + len(N.half_widths or N.h or ())
        if self.secrecy.disturbance is None:
            return 1
        D_c = self.defender.disturbance
        return self.n if D_c.half_widths is not None else len(D_c.rows()[1])

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        for name in ("A", "B"):
            if getattr(self.defender, name) is None and getattr(self.plant, name) is None:
                raise ValueError(
                    f"defender.{name}: expected the model's matrix, as a plant of kind "
                    f"{self.plant.kind!r} has none"
                )
        problems = [
            *self.plant.problems(self.n, self.m),
            *self.defender.problems(self.n, self.m, self.readings),
            *self.control.problems(self.n, self.m, self.secrecy.candidates),
        ]
        hers = self.eavesdropper_shape
        if self.secrecy.disturbance is not None:
            problems += shape_problem("secrecy.disturbance", hers.dimension, self.n)
        bounds = hers.rows()[1]
        if not all(isfinite(self.secrecy.alpha * bound) for bound in bounds):
            text = f"secrecy.alpha: alpha D_c is too large to reckon with: {self.secrecy.alpha:g}"
            problems.append(f"{text} times {max(bounds):g}")
        d = self.plant.disturbance
        may_leave = d.may_leave_defender_set or d.kind == "gaussian"
        problems += self._output_problems()
        if not problems:
            problems += self._safety_problems()
        in_state = d.enters in (None, "state")
        if not problems and in_state and not may_leave and not self.defender.covers(d):
            problems.append(
                f"plant.disturbance.half_widths: got {list(d.half_widths)}, expected a box inside "
                "defender.disturbance (D within D_c), or may_leave_defender_set = true"
            )
        if self.defence.keyed:
            problems += [
                f"defence.coin: got 'keys', and a spoofed sensor would stay unseen: {why}"
                for why in self.control.why_unseen()
            ]
        problems += self.defence.problems(self.keys, self.link)
        if scheme_named(self.secrecy.scheme).from_stream:
            problems += needs_keys(f"secrecy.scheme: {self.secrecy.scheme!r}", self.keys)
        try:
            make_scheme(self.secrecy.scheme, self.secrecy.candidates)
        except ValueError as error:
            problems.append(str(error))
        try:
            _ = self.alarm_rule
        except ValueError as error:
            problems.append(f"defence.{error}")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _output_problems(self) -> Iterator[str]:
        """What a box observer asks for, a line each."""
        if self.plant.C is None:
            if self.defender.bounds is not None:
                yield "defender.bounds: expected none, as the whole state is read (no plant.C)"
            return
        N = self.defender.noise
        if N is None or N.half_widths is None:
            yield "defender.noise: expected half_widths beside plant.C"
        if self.defender.bounds is None:
            yield "defender.bounds: got none, expected a half-width a state beside plant.C"
        if self.defender.disturbance.half_widths is None:
            yield "defender.disturbance: expected half_widths beside plant.C"
        if self.attack is not None:
            yield "attack: expected none beside plant.C, as attacks know whole states only"

    def _safety_problems(self) -> Iterator[str]:
        D_c = self.defender.disturbance
        noise, assumed = self.plant.noise, self.defender.noise
        if self.secrecy.disturbance is not None and not self.eavesdropper_set.contains(D_c):
            yield (
                "secrecy.disturbance: expected a set that, times secrecy.alpha, contains "
                "defender.disturbance (D_c within D_e, equation 11)"
            )
        if self.control.disturbance is not None and not self.control.disturbance.contains(
            self.resisted
        ):
            yield (
                "control.disturbance: expected a set that contains defender.disturbance, D_c"
                + ("" if assumed is None else ", widened by defender.noise")
            )
        may_leave = self.plant.disturbance.may_leave_defender_set
        if noise is not None and not may_leave and (assumed is None or not assumed.contains(noise)):
            yield (
                "plant.noise: expected a set inside defender.noise, N, or "
                "plant.disturbance.may_leave_defender_set = true"
            )
        if assumed is not None and self.secrecy.disturbance is not None:
            yield "secrecy.disturbance: expected none beside defender.noise"
        if assumed is not None and self.defender.model is not None:
            yield "defender.noise: expected none beside defender.model, as W takes a linear f_c"
        if self.link.fallback == "regulator" and self.control.gain is None:
            yield (
                "control.gain: expected a stated gain, as link.fallback = 'regulator' has the "
                "plant apply it by itself (wyner design shows the regulator's)"
            )
        found = self.defender.calibration
        if found is not None and found.law_fingerprint != self.law_fingerprint():
            yield (
                f"defender.calibration.law_fingerprint: got {found.law_fingerprint[:16]}..., "
                f"expected {self.law_fingerprint()[:16]}...: the certificate is stale, as the law, "
                "D_c or the start has changed since; run wyner fit, or take the table out"
            )

    def law_fingerprint(self) -> str:
        """SHA-256 (hex) over what a calibration of D_c depends on, the plant itself aside."""
        return _digest(
            {
                "A": self.A,
                "B": self.B,
                "D_c": self.defender.disturbance,
                "control": self.control.model_dump(
                    mode="json", exclude_none=True, exclude={"performance"}
                ),
                "design": self.control.design_key(self.secrecy),
                "candidates": self.secrecy.candidates,
                "period_s": self.plant.period_s,
                "initial_state": self.initial_state,
                "fallback": self.link.fallback,
                **({} if self.defender.model is None else {"model": self.defender.model}),
                **self._noise(),
                **self._own_law(),
            }
        )

    def fingerprint(self) -> str:
        """SHA-256 (hex) over what both ends must share for their verdicts to be the same.

        A scheme in a file of the user's enters with the SHA-256 of the file, too.
        Compared over the management bus only: on the field bus it would let an eavesdropper test
        Eve's guesses.
        """
        scheme, defender, C = scheme_named(self.secrecy.scheme), self.defender, self.plant.C
        missed = None
        if C is not None:  # what is predicted of a missed step follows the fallback
            fallback = self.link.fallback
            missed = (fallback, self.control.gain if fallback == "regulator" else None)
        return _digest(
            {
                "rules": RULES_VERSION,
                "scheme": (scheme.name, scheme.version, source_of(self.secrecy.scheme)),
                "A": self.A,
                "B": self.B,
                "C": (C, defender.bounds, missed),
                "D_c": defender.disturbance,
                "D_e": self.secrecy.disturbance,
                "N": defender.noise,
                "U": self.control.inputs,
                "alpha": self.secrecy.alpha,
                "deviations": defender.deviations,
                "f_c in the offer": defender.model is not None,
                "candidates": self.secrecy.candidates,
                "period_s": self.plant.period_s,
                "coin": self.defence.coin,
                "keys": self.keys,
            }
        )

    def loop_fingerprint(self) -> str:
        """SHA-256 (hex) over all that controller and plant work with: everything but the words."""
        untold = {"description", "source", "tap", "attack"}
        return _digest(self.model_dump(mode="json", exclude=untold))

    def identity(self) -> dict[str, str]:
        """What a recording says of the scenario it was made under, for a check to compare."""
        return {
            "scenario": self.name,
            "fingerprint": self.fingerprint(),
            "loop": self.loop_fingerprint(),
        }

    def design_fingerprint(self) -> str:
        """SHA-256 (hex) over what the synthesis depends on; the key of a cached design.

        So does a law in a file of the user's: it may have a synthesis of its own.
        """
        control = self.control.design_key(self.secrecy)
        return _digest(
            {
                "design": DESIGN_VERSION,
                "A": self.A,
                "B": self.B,
                "D_c": self.control_set,
                **self._noise(),
                "control": control,
                **self._own_law(),
            }
        )

    def _noise(self) -> dict[str, object]:
        """D_c and N, where W takes the place of D_c."""
        N, D_c = self.defender.noise, self.defender.disturbance
        if N is None:
            return {}
        C = {} if self.plant.C is None else {"C": self.plant.C, "bounds": self.defender.bounds}
        return {"N": N, "of": D_c, **C}

    def _own_law(self) -> dict[str, str]:
        """The source of a law in a file of the user's."""
        source = source_of(self.control.law)
        return {"law": f"{self.control.law.rpartition(':')[2]} {source}"} if source else {}

    def knowledge(self) -> Knowledge:
        """What the paper's eavesdropper knows: f_c, D_e and the control policy, not D_c."""
        H, h = self.eavesdropper_set.rows()
        policy, deviations = self.control.policy(self.n, self.m), self.defender.deviations
        if deviations is not None:  # the likeliest candidate is always there
            policy = policy.model_copy(update={"certain": True})
            deviations = tuple(self.secrecy.alpha * s for s in deviations)
        return Knowledge(
            scenario=self.name,
            period_s=self.plant.period_s,
            candidates=self.secrecy.candidates,
            scheme=self.secrecy.scheme,
            A=self.A,
            B=self.B,
            disturbance_H=H,
            disturbance_h=h,
            policy=policy,
            deviations=deviations,
            noisy=self.defender.noise is not None,
            C=self.plant.C,
            keys=None if self.keys is None else self.keys.assumption(),
            digits=self.digits,
        )

    def oracle_knowledge(self) -> Knowledge:
        """What the defender knows, in the form a tap reads: the control of the measurement."""
        told: dict[str, object] = {"alpha": self.secrecy.alpha}
        noisy = self.defender.noise is not None
        if noisy or self.secrecy.disturbance is not None:
            H, h = self.test_set.rows()
            told |= {"defender_H": H, "defender_h": h}
        return self.knowledge().model_copy(update=told)


@lru_cache(maxsize=64)
def _quiet(observer: BoxObserver) -> FiniteVector:
    """Half-widths of the observer's box in a quiet loop."""
    return observer.quiet()


def _stated(table: ScenarioTable) -> dict[str, object]:
    """A table within a digest."""
    return table.model_dump(mode="json", exclude_none=True)


def _digest(value: object) -> str:
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), default=_stated)
    return hashlib.sha256(canonical.encode()).hexdigest()
