"""Does a run obey the paper? A few rules, each with a name, and the places where one is broken.

A rule is of one of five kinds. A replay evaluates the pure functions of both ends
(:mod:`protocol.agreement`, the scheme, :mod:`protocol.schemes.framing`) on the raw numbers of the
traces: it finds a trace that its program did not write. The rule ``paper`` asks code that shares
nothing with the ends (:mod:`wyner.runs.check.paper`): it finds a program that is wrong. The bus's
compare the capture with a table of what may stand there. Agreements join files with each other.
Integrity holds every file to what its writer counted, and to the manifest.
"""

import gc
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from wyner.runs.check import agreements, alarms, bus, files, messages, opinion, plant, replay
from wyner.runs.check.evidence import Evidence, Finding, Findings

MOST: Final = 100
"""Findings of one rule that are kept."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One thing that the paper or the protocol demands of a run.

    Parameters
    ----------
    name : str
    source : str
        The paper's equation or figure, or the rule of docs/protocol.md.
    says : str
        What must hold, in one line.
    """

    name: str
    source: str
    says: str

    def skipped(self, e: Evidence) -> str:
        """Why there is nothing to look at; empty where there is."""
        if self.name == "paper" and (own := opinion.skipped(e)):
            return own
        if self.name == "same-keys" and e.rules.schedule is None:
            return "no keys are made of what Eve misses"
        if e.cut and self.name != "whole" and not any(len(trace.rows) for trace in e.ends()):
            return e.cut
        missing = [name for name in NEEDS.get(self.name, ()) if getattr(e, name) is None]
        return f"the run left nothing of the {' and the '.join(missing)}" if missing else ""


RULES: Final = (
    Rule("traces", "rule 5", "lines are as they should be, transitions numbered without a gap"),
    Rule("whole", "rule 6", "every file is as its writer left it, of one scenario, and as far on"),
    Rule(
        "replay",
        "(20), (21), rule 4",
        "verdicts, keys, symbols and fallback follow from the raw numbers",
    ),
    Rule(
        "paper", "Figs. 5, 6, (22)", "the paper's test and automata, written a second time, agree"
    ),
    Rule("plant", "(6), (14), (15)", "each step applies candidate b_r, and leads into its Reach^c"),
    Rule("admissible", "(27)", "every candidate is in U and leads into T_(i-1) ~ D_c"),
    Rule("messages", "rule 7", "frames pass their check, are reported, and follow the queue"),
    Rule("alarms", "rule 12", "an alarm is told where its test failed, and nowhere else"),
    Rule("bus", "assumption 2", "public fields alone, and they look the same in both states"),
    Rule("wire", "rules 1 to 3", "what the tap read is the plant's, a repeated message the same"),
    Rule("in-step", "proposition 3", "both ends agree on every transition"),
    Rule(
        "once", "section 4.2, rules 8, 11", "no key, digit, nonce or copy 0 serves or leaves twice"
    ),
    Rule("same-keys", "rules 9, 11", "tags, counted copies and keyed coins are alike at both ends"),
    Rule("blocks", "rule 10", "a block makes as many keys as its transitions allow"),
)

NEEDS: Final = {
    "plant": ("plant",),
    "alarms": ("controller",),
    "in-step": ("plant", "controller"),
    "bus": ("capture",),
    "wire": ("capture",),
}
"""What there must be, else a rule has nothing to look at."""

TELLERS: Final[dict[str, Callable[..., Findings]]] = {
    "traces": files.traces,
    "replay": replay.replay,
    "paper": opinion.paper,
    "plant": plant.plant,
    "admissible": plant.admissible,
    "messages": messages.messages,
    "alarms": alarms.alarms,
    "in-step": agreements.in_step,
    "once": agreements.once,
    "blocks": agreements.blocks,
    "bus": bus.bus,
    "whole": files.whole,
}
"""Who tells of a rule, and of others on the way, from the evidence and what the rule needs. In this
order: the bus lets go of the controller's rows, and what a capture's marks say is known after it.
"""


def check(e: Evidence) -> list[Finding]:
    """Every place where a run does not obey a rule, of each rule the first :data:`MOST`."""
    found: list[Finding] = []
    counts: Counter[str] = Counter()
    threshold = gc.get_threshold()
    gc.set_threshold(200_000, *threshold[1:])  # thousands of tuples, and no cycle among them
    try:
        with np.errstate(all="ignore"):  # a damaged trace holds any number
            for finding in _told(e):
                counts[finding.rule] += 1
                if counts[finding.rule] <= MOST:
                    found.append(finding)
    finally:
        gc.set_threshold(*threshold)
    return found


def _told(e: Evidence) -> Findings:
    for name, tell in TELLERS.items():
        needed = [getattr(e, what) for what in NEEDS.get(name, ())]
        if None not in needed:
            yield from tell(e, *needed)


@dataclass(frozen=True, slots=True)
class RuleResult:
    """How a run did by a rule.

    Parameters
    ----------
    rule : Rule
    result : str
        ``PASS``, ``FAIL`` or ``SKIP``; SKIP where the run left nothing to look at.
    findings : list of Finding
        Where the rule is broken.
    note : str
        What must be known of the result: why it was skipped, which parts of the traces are gone.
    """

    rule: Rule
    result: str
    findings: list[Finding]
    note: str

    def __str__(self) -> str:
        """One line, and one more for the first place where the rule is broken."""
        rule, findings = self.rule, self.findings
        note = f" [{self.note}]" if self.note else ""
        line = f"{self.result}  {rule.name:10} {rule.says}; see {rule.source}{note}"
        if not findings:
            return line
        many = f"{len(findings)} findings" if len(findings) > 1 else "1 finding"
        first = str(findings[0]).removeprefix(f"{rule.name}: ")
        return f"{line}\n      {many}, first: {first}"

    def as_json(self) -> dict[str, Any]:
        """The result for machines; ``failures`` counts to :data:`MOST`."""
        return {
            "name": self.rule.name,
            "source": self.rule.source,
            "says": self.rule.says,
            "result": self.result,
            "failures": len(self.findings),
            "first": asdict(self.findings[0]) if self.findings else None,
            "note": self.note,
        }


def judge(e: Evidence) -> list[RuleResult]:
    """Every rule, and how the run did by it."""
    skipped = [rule.skipped(e) for rule in RULES]  # while all rows are there
    found, results = check(e), []
    for rule, why in zip(RULES, skipped, strict=True):
        findings = [f for f in found if f.rule == rule.name]
        result = "FAIL" if findings else "SKIP" if why else "PASS"
        note = e.cut if rule.name == "traces" else ""
        results.append(RuleResult(rule, result, findings, why or note))
    return results


def counts(results: list[RuleResult]) -> str:
    """How many rules passed, failed and were skipped."""
    kinds = Counter(result.result for result in results)
    return ", ".join(f"{kinds[kind]} {kind}" for kind in ("PASS", "FAIL", "SKIP"))
