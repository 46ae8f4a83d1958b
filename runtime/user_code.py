"""Code that a scenario names: ``module:attribute`` or ``file.py:attribute``.

A plant's is loaded by the plant's process alone, a model's by the controller's; it runs with that
process's rights.
"""

from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any

from protocol.plugins import UnknownError, module_at
from protocol.scenario import Scenario
from protocol.vectors import Vector
from runtime.errors import Failure


class UserCodeError(Failure):
    """Code that is not there, or cannot be loaded; one line."""


def load_attribute(name: str, folder: Path) -> Any:
    """The object that ``name`` stands for.

    Parameters
    ----------
    name : str
        ``module:attribute``, or ``file.py:attribute`` with the file relative to ``folder``.
    folder : Path
        Where the scenario is.

    Raises
    ------
    UserCodeError
        When there is no such file, module or attribute, or loading it fails.
    """
    where, colon, attribute = name.rpartition(":")
    if not colon or not where or not attribute:
        raise UserCodeError(f"got {name!r}, expected 'file.py:attribute' or 'module:attribute'")
    try:
        module, _ = module_at(where, folder)
    except UnknownError as error:
        raise UserCodeError(str(error)) from error.__cause__
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise UserCodeError(f"{where}: has no {attribute!r}") from None


def made(found: Any, name: str) -> Any:
    """``found`` itself, or an instance of it where it is a class.

    Raises
    ------
    UserCodeError
    """
    if not isinstance(found, type):
        return found
    try:
        return found()
    except Exception as error:
        raise UserCodeError(f"{name}: {type(error).__name__}: {error}") from error


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
