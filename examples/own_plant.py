"""An object of one's own as the plant: reset and step, in physical units, and nothing else."""

import random

from wyner import build, design, run


class Cart:
    """A cart with air drag; place (m) and speed (m/s), pushed by a force, in gusts of wind."""

    def reset(self, seed: int | None) -> list[float]:
        """Stand at the start; a seed for the wind."""
        self.x, self.wind = [0.0, 0.0], random.Random(seed)
        return self.x

    def step(self, u: tuple[float, ...], period_s: float) -> list[float]:
        """The cart a period on, in ten small steps."""
        place, speed = self.x
        gust = self.wind.uniform(-0.05, 0.05)
        for _ in range(10):
            force = 2.0 * u[0] + gust - 0.2 * speed - 0.8 * speed * abs(speed)
            place += speed * period_s / 10
            speed += force * period_s / 10
        self.x = [place, speed]
        return self.x


cart = design(
    build(
        {
            "name": "cart",
            "plant": {
                "kind": "python",
                "object": "own_plant.py:Cart",
                "period_s": 0.1,
                "disturbance": {"enters": "none"},
            },
            "defender": {
                "A": [[1.0, 0.0991], [0.0, 0.9802]],
                "B": [[0.0089], [0.1981]],
                "disturbance": {"half_widths": [0.0015, 0.0075]},
            },
            "control": {
                "law": "packed",
                "horizon": 5,
                "inputs": {"half_widths": [2.0]},
                "gain": [[-1.0, -1.5]],
            },
            "secrecy": {"alpha": 8.0, "candidates": 4},
        }
    )
)
runs = run(cart, steps=500, seed=3, message=b"hello", plant=Cart())
tested = int((runs.message_symbol < 0).sum())
print(f"{runs.agreements[0]} of {tested} tested steps agreed, {runs.rate.value:.1f} bit/s")
print(f"recovered {runs.messages[0]}, |x| up to {abs(runs.x[0]).max(axis=0).round(3).tolist()}")
