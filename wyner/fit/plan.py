"""How a plant is run for a fit: options of ``wyner fit``."""

from dataclasses import dataclass

from runtime.options import option


@dataclass(frozen=True, slots=True)
class Plan:
    """How many sessions a fit takes, and what they are like."""

    sessions: int = option(
        "sessions that scale D_c, and as many that certify it (100)", "N", 100, least=1
    )
    steps: int = option("steps of a session under the law (200)", "N", 200, least=1)
    excite_steps: int = option(
        "steps of one with random inputs; few for an unstable plant (100)", "N", 100, least=1
    )
    seed: int = option("seed of excitation, coins and disturbance (1)", "N", 1)
    amplitude: float = option("of the random inputs, as a share of U (0.3)", "P", 0.3)

    @property
    def few(self) -> int:
        """Sessions with random inputs, and as many that give D_c its shape."""
        return max(1, self.sessions // 5)
