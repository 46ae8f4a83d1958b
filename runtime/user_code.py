"""Code that a scenario names: ``module:attribute`` or ``file.py:attribute``.

A plant's is loaded by the plant's process alone, a model's by the controller's; it runs with that
process's rights.
"""

from pathlib import Path
from typing import Any

from protocol.plugins import UnknownError, module_at
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
