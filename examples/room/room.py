"""A heated room, in degrees; the set point is 21."""


class Room:
    """Warms by 0.2 degrees a second and unit of input; loses a hundredth of its excess over 15."""

    def reset(self, _seed):
        """The first reading."""
        self.t = 20.0
        return (self.t,)

    def step(self, u, period_s):
        """Apply ``u`` for a period; the next reading."""
        self.t += period_s * (0.2 * u[0] - 0.01 * (self.t - 15.0))
        return (self.t,)
