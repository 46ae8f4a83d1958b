"""How fast plant time passes."""


class Pace:
    """How fast plant time passes: ``realtime``, ``xN`` times that, or ``fast`` (lock-step).

    Parameters
    ----------
    text : str
        As the user writes it.

    Raises
    ------
    ValueError
        When it is none of the three.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.factor: float | None
        if text == "fast":
            self.factor = None
        elif text == "realtime":
            self.factor = 1.0
        else:
            try:
                self.factor = float(text.removeprefix("x")) if text.startswith("x") else 0.0
            except ValueError:
                self.factor = 0.0
            if not 0 < self.factor < float("inf"):
                raise ValueError(f"got {text!r}, expected realtime, fast, or xN such as x10")

    @property
    def scale(self) -> float:
        """Seconds of wall time in a second of plant time; 1 in lock-step."""
        return 1.0 if self.factor is None else 1.0 / self.factor

    def step_s(self, period_s: float) -> float | None:
        """Seconds of wall time in a step of ``period_s`` seconds; None in lock-step."""
        return None if self.factor is None else period_s / self.factor
