"""Dynamics of the shipped plants that are no matrices: dx/dt = f(t, x, u) in physical units.

Only the plant's process loads this. It is plain Python: the same numbers on every machine whose
library has the same sine.
"""

from collections.abc import Sequence
from math import cos, sin, sqrt, tanh

Vector = tuple[float, ...]

G_OVER_L = 9.81
DAMPING = 0.5
TORQUE = 5.0


def pendulum(t: float, x: Sequence[float], u: Sequence[float]) -> Vector:  # noqa: ARG001
    """An inverted pendulum of 1 m: angle from upright (rad) and its rate; the input is a torque."""
    return (x[1], G_OVER_L * sin(x[0]) - DAMPING * x[1] + TORQUE * u[0])


def predict_pendulum(x: Vector, u: Vector) -> Vector:
    """A nonlinear f_c of the pendulum: its state 0.1 s on, by two Runge-Kutta steps."""
    from protocol.integration import runge_kutta_step

    middle = runge_kutta_step(pendulum, 0.0, x, u, 0.05)
    return runge_kutta_step(pendulum, 0.05, middle, u, 0.05)


VISCOUS = 0.5
COULOMB = 0.5
SMOOTHING = 0.1
MOTOR_GAIN = 5.0


def motor(t: float, x: Sequence[float], u: Sequence[float]) -> Vector:  # noqa: ARG001
    """A motor's angle and speed, with viscous and dry friction; the input is a voltage."""
    friction = VISCOUS * x[1] + COULOMB * tanh(x[1] / SMOOTHING)
    return (x[1], MOTOR_GAIN * u[0] - friction)


CRUISE = 1.0


def unicycle(t: float, x: Sequence[float], u: Sequence[float]) -> Vector:  # noqa: ARG001
    """A unicycle robot beside a reference that drives straight at 1 m/s.

    State: how far it is ahead and to the left (m), and its heading (rad). Input: how much faster
    than the reference it drives (m/s), and how fast it turns (rad/s).
    """
    speed = CRUISE + u[0]
    return (speed * cos(x[2]) - CRUISE, speed * sin(x[2]), u[1])


AREAS = (28.0, 32.0, 28.0, 32.0)
OUTLETS = (0.071, 0.057, 0.071, 0.057)
PUMPS = (3.33, 3.35)
VALVES = (0.70, 0.60)
GRAVITY = 981.0


def quadruple_tank(t: float, x: Sequence[float], u: Sequence[float]) -> Vector:  # noqa: ARG001
    """Levels (cm) of four tanks fed by two pumps (V): Johansson 2000, equation (1).

    An empty tank stays empty: no more flows out than is there.
    """
    flows = [a * sqrt(2.0 * GRAVITY * max(h, 0.0)) for a, h in zip(OUTLETS, x, strict=True)]
    q1, q2 = (k * v for k, v in zip(PUMPS, u, strict=True))
    into = (
        flows[2] + VALVES[0] * q1,
        flows[3] + VALVES[1] * q2,
        (1.0 - VALVES[1]) * q2,
        (1.0 - VALVES[0]) * q1,
    )
    return tuple([(i - o) / area for i, o, area in zip(into, flows, AREAS, strict=True)])
