"""What an attack's labels say in a plant's trace: who lies, from when on, and what the truth is.

From the onset on the plant's rules see the true state, and the controller's see what is reported.
"""

from dataclasses import fields

from wyner.runs.check.records import AttackLine, MissedLine, TracedTransition


def lies(attack: AttackLine | None, k: int) -> bool:
    """Whether what is said of step k, or of its end, need not be the truth of the plant."""
    return attack is not None and attack.at != "bus" and k + 1 >= attack.onset


def rewrites(attack: AttackLine | None, k: int) -> bool:
    """Whether the two ends need not have the same numbers of step k."""
    return attack is not None and attack.at == "bus" and k + 1 >= attack.onset


def wrong_labels(
    attack: AttackLine | None,
    step: TracedTransition | MissedLine,
    *,
    restarted: bool,
    noisy: bool = False,
    states: int = 0,
) -> str:
    """What is wrong with a step's labels; empty where nothing is.

    ``states`` are the truth's, where outputs alone are read. ``restarted``: a process died before
    it, with the truth of what is counted from its journal.
    """
    x, u = step.true_x_next, step.true_u
    if noisy and (attack is None or attack.at == "bus"):
        fits = x is None or len(x) == (states or len(step.x))
        return "" if fits else "the truth is of another shape"
    if attack is None or attack.at == "bus":
        return "" if x is None and u is None else "a truth, and no attack on the plant"
    if x is None or u is None:
        lost = restarted or (isinstance(step, MissedLine) and step.interrupted)
        return "" if lost else "no truth, of an attacked plant"
    if (len(x), len(u)) != (len(step.x), len(step.u or ())):
        return "the truth is of another shape"
    if not noisy and x != step.x_next and (attack.at != "sensor" or step.k + 1 < attack.onset):
        return f"reported x(k+1) = {list(step.x_next)}, the truth is {list(x)}"
    if u != step.u and (attack.at != "actuator" or step.k < attack.onset):
        return f"u = {list(step.u or ())} was chosen, the truth is {list(u)}"
    return ""


def unlike_manifest(attack: AttackLine | None, said: object) -> str:
    """How what the trace names differs from the manifest; empty where it does not."""
    if said is None or attack is None:
        return ""
    told = {f.name: getattr(attack, f.name) for f in fields(attack) if f.name != "event"}
    told["knows"] = list(attack.knows)
    return "" if told == said else f"the trace names {told}, the manifest {said}"
