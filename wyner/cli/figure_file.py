"""A command's table as a figure in a file, where matplotlib is there."""

from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from runtime.errors import Failure, UsageError, needs


def save_table(name: str, drawing_function: str, result: dict[str, Any]) -> None:
    """Draw ``result`` into the file ``name``, and print the name.

    Parameters
    ----------
    name : str
    drawing_function : str
        MODULE:NAME of what takes a figure and the result.
    result : dict

    Raises
    ------
    UsageError
        Where matplotlib is missing.
    Failure
        Where the file cannot be written.
    """
    try:
        from wyner.drawing.style import drawing, save

        draw = resolve_name(drawing_function)
    except ImportError:
        raise UsageError(needs("--plot", "matplotlib")) from None
    with drawing((7.0, 4.2)) as figure:
        draw(figure, result)
        try:
            save(figure, Path(name))
        except OSError as error:
            raise Failure(f"{name}: cannot be written: {error.strerror}") from None
    print(name)
