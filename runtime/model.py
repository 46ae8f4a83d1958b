"""A nonlinear f_c of the user's, as the controller calls it."""

from collections.abc import Callable
from math import isfinite
from pathlib import Path

from protocol.scenario import Scenario
from protocol.vectors import Vector
from runtime.user_code import UserCodeError, load_attribute


class ModelError(LookupError):
    """A state for which the model has no prediction."""


def load_model(scenario: Scenario, folder: Path) -> Callable[[Vector, Vector], Vector] | None:
    """The scenario's f_c; None where it is linear.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Where the file that ``defender.model`` names is looked for.

    Raises
    ------
    UserCodeError
        When it is not there, or no function.
    """
    name = scenario.defender.model
    if name is None:
        return None
    try:
        function = load_attribute(name, folder)
    except UserCodeError as error:
        raise UserCodeError(f"defender.model: {error}") from error.__cause__
    if not callable(function):
        raise UserCodeError(f"defender.model: {name}: expected a function of x and u")
    n = scenario.n

    def predict(x: Vector, u: Vector) -> Vector:
        try:
            centre = tuple([float(v) for v in function(x, u)])
        except Exception as error:  # the user's code: whatever it raises is told in one line
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise ModelError(f"defender.model at x = {list(x)}: {text}") from error
        if len(centre) != n or not all(map(isfinite, centre)):
            raise ModelError(
                f"defender.model at x = {list(x)}: got {list(centre)}, expected {n} finite numbers"
            )
        return centre

    return predict
