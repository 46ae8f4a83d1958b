"""A plant on a line, x+ = x + u + d with D_c = [-1, 1]: the smallest that has the whole link."""

from protocol.agreement import AgreementRule, Gauge
from protocol.link.session import Rules
from protocol.schemes.switched import Switched


def line_rules(alpha: float, largest_input: float, fingerprint: str = "f" * 64) -> Rules:
    """What both ends share of it, for two candidates."""
    gauge = Gauge(half_widths=(1.0,))
    return Rules(
        agreement=AgreementRule(A=((1.0,),), B=((1.0,),), gauge=gauge, alpha=alpha),
        scheme=Switched(2),
        states=1,
        inputs=1,
        fingerprint=fingerprint,
        inputs_gauge=Gauge(half_widths=(largest_input,)),
    )
