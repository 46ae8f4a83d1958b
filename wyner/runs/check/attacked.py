"""What an attack's labels say, in a trace of an attacked plant: who lies, from when, and the truth.

From the onset on the plant's rules see the true state, and the controller's see what is reported.
"""

from wyner.runs.check.records import (
    AttackLine,
    Break,
    Item,
    MissedLine,
    Told,
    TracedTransition,
    Walked,
)

Step = TracedTransition | MissedLine


class Labels:
    """Follows a plant's trace, item by item.

    Attributes
    ----------
    attack : AttackLine, optional
        The attack, as the trace has named it.
    """

    def __init__(self) -> None:
        self.attack: AttackLine | None = None
        self._restarted = True

    def step(self, item: Item) -> Step | None:
        """The step that an item is, if it is one; take in what else it says."""
        if isinstance(item, Walked):
            return item.t
        if isinstance(item, MissedLine):
            return item
        if isinstance(item, Told) and isinstance(item.line, AttackLine):
            self.attack = item.line
        self._restarted = self._restarted or isinstance(item, Break)
        return None

    def lies(self, k: int) -> bool:
        """Whether what is said of the step k, or of its end, need not be the truth."""
        attack = self.attack
        return attack is not None and attack.at != "bus" and k + 1 >= attack.onset

    def wrong(self, step: Step) -> str:
        """What is wrong with a step's labels; empty where nothing is."""
        attack, restarted = self.attack, self._restarted
        self._restarted = False
        x, u = step.true_x_next, step.true_u
        if attack is None or attack.at == "bus":
            return "" if x is None and u is None else "a truth, and no attack on the plant"
        if x is None or u is None:
            # counted from the journal, or interrupted: the truth went with the process
            dead = restarted or (isinstance(step, MissedLine) and step.interrupted)
            return "" if dead else "no truth, of an attacked plant"
        if (len(x), len(u)) != (len(step.x), len(step.u or ())):
            return "the truth is of another shape"
        if x != step.x_next and (attack.at != "sensor" or step.k + 1 < attack.onset):
            return f"reported x(k+1) = {list(step.x_next)}, the truth is {list(x)}"
        if u != step.u and (attack.at != "actuator" or step.k < attack.onset):
            return f"u = {list(step.u or ())} was chosen, the truth is {list(u)}"
        return ""


def wanting(attack: AttackLine | None, said: object) -> str:
    """How what the trace names differs from the manifest; empty where it does not."""
    if said is None or attack is None:
        return ""
    told = {"kind": attack.kind, "at": attack.at, "onset": attack.onset}
    expected = {name: said.get(name) for name in told} if isinstance(said, dict) else said
    return "" if told == expected else f"the trace names {told}, the manifest {expected}"
