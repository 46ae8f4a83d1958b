"""Code that a scenario names: ``module:attribute`` or ``file.py:attribute``.

Only the plant's process loads it, and it runs with that process's rights.
"""

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any, cast

from plant_service.adapters.base import PlantError, Stepped


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
    PlantError
        When there is no such file, module or attribute, or loading it fails.
    """
    where, colon, attribute = name.rpartition(":")
    if not colon or not where or not attribute:
        raise PlantError(f"got {name!r}, expected 'file.py:attribute' or 'module:attribute'")
    try:
        module = (
            _load_file(folder / where) if where.endswith(".py") else importlib.import_module(where)
        )
    except FileNotFoundError:
        raise PlantError(f"{folder / where}: no such file") from None
    except ModuleNotFoundError as error:
        raise PlantError(f"{where}: {error}") from None
    except Exception as error:
        raise PlantError(f"{where}: cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise PlantError(f"{where}: has no {attribute!r}") from None


def _load_file(path: Path) -> Any:
    if not path.is_file():
        raise FileNotFoundError(path)
    resolved = path.resolve()
    spec = importlib.util.spec_from_file_location(f"wyner_plant_{resolved.stem}", resolved)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses and pickles look their module up
    spec.loader.exec_module(module)
    return module


def made(found: Any, name: str) -> Any:
    """``found`` itself, or an instance of it where it is a class.

    Raises
    ------
    PlantError
    """
    if not isinstance(found, type):
        return found
    try:
        return found()
    except Exception as error:
        raise PlantError(f"{name}: {type(error).__name__}: {error}") from error


def stepped(plant: Any, name: str) -> Stepped:
    """``plant``, once it has both methods of :class:`Stepped`.

    Raises
    ------
    PlantError
    """
    for method in ("reset", "step"):
        if not callable(getattr(plant, method, None)):
            raise PlantError(
                f"{name}: has no method {method}, expected reset(seed) and step(u, period_s)"
            )
    return cast(Stepped, plant)
