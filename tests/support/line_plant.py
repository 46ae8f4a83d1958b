"""A plant on a line, x+ = x + u + d with D_c = [-1, 1]: the smallest that has the whole link."""

from typing import Any

from protocol.agreement import AgreementRule, Gauge
from protocol.link.session import Rules
from protocol.schemes.base import Scheme
from protocol.schemes.switched import Switched


def line_rules(
    alpha: float,
    largest_input: float,
    fingerprint: str = "f" * 64,
    scheme: Scheme[Any] | None = None,
) -> Rules:
    """What both ends share of it; the paper's scheme for two candidates if none is given."""
    gauge = Gauge(half_widths=(1.0,))
    return Rules(
        agreement=AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=alpha),
        scheme=Switched(2) if scheme is None else scheme,
        states=1,
        inputs=1,
        fingerprint=fingerprint,
        inputs_gauge=Gauge(half_widths=(largest_input,)),
    )
