"""Does a run obey the paper? A table of clauses, each a function that looks at the evidence.

A clause counts what it looked at and keeps the first place where it did not hold. There are three
kinds. A replay evaluates the pure functions of both ends (:mod:`protocol.agreement`, the scheme,
:mod:`protocol.schemes.framing`) on the raw numbers of the traces: it finds a trace that its program
did not write. Others compare files with each other. The clause ``paper`` asks code that shares
nothing with the ends (:mod:`wyner.runs.check.paper`): it finds a program that is wrong.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from wyner.runs.check import bus, files, key_blocks, keys, loop, message, sealed, stores
from wyner.runs.check.clause import Clause, Finding, Tally
from wyner.runs.check.evidence import Evidence, Part

OVER: Final = object()

CLAUSES: Final[tuple[Clause, ...]] = (
    Clause("traces", "rule 5", "transitions are whole and numbered without a gap",
           "transitions", files.traces),
    Clause("scenario", "rule 6", "every file was made under the scenario that is there",
           "comparisons", files.scenario),
    Clause("whole", "rule 6",
           "every file is as its writer left it, every trace as far on as its journal",
           "files", files.whole),
    Clause("switching", "(15), rule 4",
           "every step applies candidate b_r, a missed one the fallback",
           "steps", loop.switching),
    Clause("reachable", "(6), (14)", "x(k+1) is in Reach^c of the applied input, within Reach^e",
           "steps", loop.reachable),
    Clause("admissible", "(27)", "every candidate is in U and leads into T_(i-1) ~ D_c",
           "candidates", loop.admissible),
    Clause("agreement", "(20), (21)", "both verdicts follow from x, the candidates and x(k+1)",
           "verdicts", keys.agreement),
    Clause("coin", "(22)", "the agreed symbol is the plant's own coin", "keys", keys.coin),
    Clause("sender", "Figs. 5, 6a", "the scheme gives what the controller recorded",
           "transitions", keys.sender),
    Clause("receiver", "Figs. 5, 6b", "the scheme gives what the plant recorded",
           "transitions", keys.receiver),
    Clause("paper", "Figs. 5, 6", "the paper's test and automata, written a second time, agree",
           "transitions", keys.paper),
    Clause("in-step", "proposition 3", "both ends agree on every transition both have counted",
           "transitions", keys.in_step),
    Clause("prefix", "proposition 3", "what was recovered is a prefix of what was sent",
           "symbols", message.prefix),
    Clause("frames", "rule 7", "every frame passes its check and is reported",
           "frames", message.frames),
    Clause("messages", "rule 7", "recovered messages are the queued ones, in order",
           "messages", message.messages),
    Clause("one-time-pad", "section 4.2", "every key symbol serves one message symbol",
           "message symbols", message.one_time_pad),
    Clause("one-cipher", "rule 3", "a transition's cipher symbol is decided once",
           "offers", message.one_cipher),
    Clause("same-answer", "rule 2", "a repeated message is the same, but for its copy and nonce",
           "messages", bus.same_answer),
    Clause("wire", "assumption 2", "what the tap read is what the plant worked with",
           "messages", bus.wire),
    Clause("public-fields", "assumption 2", "the field bus carries nothing but public fields",
           "messages", bus.public_fields),
    Clause("same-shape", "proposition 3", "messages look the same in both automaton states",
           "messages", bus.same_shape),
    Clause("nonce-once", "rule 8", "no nonce travels twice", "messages", key_blocks.nonce_once),
    Clause("copy-0-once", "rule 8", "a step's copy 0 leaves at most once",
           "copies 0", key_blocks.copy_0_once),
    Clause("counted", "rule 9", "both ends count the same copies",
           "transitions", key_blocks.counted),
    Clause("blocks", "rule 10", "a block makes as many keys as its transitions allow",
           "blocks", key_blocks.blocks),
    Clause("tags", "rule 10", "a block has one tag", "messages", key_blocks.tags),
    Clause("pads-once", "rule 10", "a set of pads signs one block", "blocks", key_blocks.pads_once),
    Clause("given-once", "rule 11", "what one end gave has its mark at the other",
           "keys", key_blocks.given_once),
    Clause("key-ids", "rule 10", "both stores hold the same ids in one order, in disjoint halves",
           "keys", key_blocks.key_ids),
    Clause("key-stores", "rule 10", "each store holds what its end stored, and nobody changed it",
           "rows", stores.key_stores),
    Clause("sealed-once", "rule 11", "a key seals one message, which travels as both ends have it",
           "messages", sealed.sealed_once),
    Clause("refused-at-zero", "rule 10", "where nothing is claimed there is no key",
           "messages", key_blocks.refused_at_zero),
)  # fmt: skip


OF_KEYS: Final = frozenset(
    {
        "nonce-once",
        "copy-0-once",
        "counted",
        "blocks",
        "tags",
        "pads-once",
        "given-once",
        "key-ids",
        "key-stores",
        "sealed-once",
    }
)
"""Clauses of which a scenario that makes no keys knows nothing."""


def check(evidence: Evidence, watch: Callable[[Part], None] | None = None) -> list[Finding]:
    """Judge every clause, in one passage over the run; ``watch`` is shown each part as well."""
    keys = evidence.rules.schedule is not None
    findings = [
        Finding(clause, Tally()) for clause in CLAUSES if keys or clause.name not in OF_KEYS
    ]
    judging = []
    for finding in findings:
        judge = finding.clause.judge(evidence, finding.tally)
        if next(judge, OVER) is not OVER:
            judging.append(judge)
    for part in evidence.parts():
        for judge in judging:
            judge.send(part)
        if watch is not None:
            watch(part)
    for judge in judging:
        with suppress(StopIteration):
            judge.send(None)
    return findings
