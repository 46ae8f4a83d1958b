"""Finds the rates and probabilities that are printed for machines without interval or reason.

A figure is accounted for by limits beside it (``low`` and ``high``, ``NAME_interval_95``,
``interval_95``), or by ``no_interval``: a text in the same object or in one around it, or a table
that names the figure.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

FIGURE: Final = re.compile(
    r"probability|share|accuracy|(^|_)rate$|per_second|missed_by|^guess(ing)?(_|$)|violation"
    r"|bits_per_|_hz$|_error_rate|entropy|^measured$|control_cost"
)
"""Names of rates, probabilities and means of what was measured."""


def bare_figures(value: Any, reasons: Mapping[str, str] | str = "", at: str = "") -> Iterator[str]:
    """Paths of the figures that nothing accounts for."""
    if isinstance(value, list):
        for item in value:
            yield from bare_figures(item, reasons, f"{at}[]")
    if not isinstance(value, dict):
        return
    own = value.get("no_interval")
    if isinstance(own, str) and own:
        return
    if isinstance(own, dict):
        outer = reasons if isinstance(reasons, dict) else {}
        reasons = {**outer, **own}
    if {"value", "low", "high"} <= value.keys():
        if not (_number(value["low"]) and _number(value["high"])):
            yield at
        return
    for name, item in value.items():
        here = f"{at}.{name}"
        if isinstance(reasons, dict) and reasons.get(name):
            continue
        if FIGURE.search(name) and _number(item) and not _limits(value, name):
            yield here
        else:
            yield from bare_figures(item, reasons, here)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _limits(value: Mapping[str, Any], name: str) -> bool:
    stem = name.removesuffix("_probability")
    for beside in (f"{name}_interval_95", f"{stem}_interval_95", f"{name}_interval", "interval_95"):
        limits = value.get(beside)
        if isinstance(limits, list) and limits and all(map(_number, limits)):
            return True
    return False
