"""What goes wrong in a simulated network: messages, processes, journals."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Faults:
    """How bad the world is, in probabilities a message or an event, and seconds.

    Parameters
    ----------
    loss, repeat : float
        Probability that a message vanishes, or arrives twice.
    delay_s : float
        Each arrival is late by a uniform time up to this, so messages overtake one another.
    crash : float
        Probability that a process dies over an event: before it has saved what came of it, after
        that but before it has sent anything, before it has traced or kept it, or after all.
    amnesia : float
        Probability that a process that died comes back without its journal.
    down_s : float
        A dead process comes back after a uniform time up to this.
    until_s : float
        From here on the network and the processes are well (for liveness).
    """

    loss: float = 0.0
    repeat: float = 0.0
    delay_s: float = 0.0
    crash: float = 0.0
    amnesia: float = 0.0
    down_s: float = 0.3
    until_s: float = float("inf")
