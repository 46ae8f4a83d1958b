"""The ladder of eavesdroppers, from the paper's own to the oracle, and how to find one by name.

``named("list-decoder")`` gives a class of the ladder; ``named("path/to/file.py:Name")`` one of the
user's own. Modules are loaded when they are asked for.
"""

import importlib
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Final

from tap_service.eavesdroppers.base import (
    Belief,
    Eavesdropper,
    Guess,
    KnowledgeError,
)

__all__ = ["LADDER", "Belief", "Eavesdropper", "Guess", "KnowledgeError", "named"]

LADDER: Final[dict[str, str]] = {
    "set-membership": "set_membership:SetMembership",
    "nearest-centre": "nearest_centre:NearestCentre",
    "list-decoder": "list_decoder:ListDecoder",
    "learning": "learning:Learning",
    "smoother": "smoother:Smoother",
    "oracle": "oracle:Oracle",
}
"""Each name with its module and class, weakest first."""

ORACLE: Final = "oracle"
"""The one that must be told alpha."""

DEFAULT: Final = ("set-membership", "nearest-centre", "list-decoder")
"""Without a choice: the strongest on a clear view, and the two it is compared with."""

DEFAULT_UNCLEAR: Final = ("set-membership", "nearest-centre", "list-decoder", "smoother")
"""The same where the tap hears badly."""


def named(name: str) -> type[Eavesdropper]:
    """The class of an eavesdropper, by its name in the ladder or as ``FILE.py:NAME``.

    Raises
    ------
    KnowledgeError
        With one line, when there is no such eavesdropper.
    """
    if name in LADDER:
        module_name, _, class_name = LADDER[name].partition(":")
        module = importlib.import_module(f"tap_service.eavesdroppers.{module_name}")
        return _class_in(module, class_name, name)
    path, colon, class_name = name.rpartition(":")
    if not colon or not path.endswith(".py"):
        raise KnowledgeError(
            f"eavesdropper: got {name!r}, expected {', '.join(LADDER)} or path/to/file.py:Name"
        )
    return _class_in(_load_file(Path(path), name), class_name, name)


def _load_file(path: Path, name: str) -> ModuleType:
    stem = re.sub(r"\W", "_", path.stem)
    spec = importlib.util.spec_from_file_location(f"eavesdropper_{stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise KnowledgeError(f"eavesdropper: got {name!r}, expected an existing Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a dataclass looks its own module up there
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # the file is the user's: whatever it raises is told in one line
        raise KnowledgeError(
            f"eavesdropper: {path}: cannot be loaded: {type(error).__name__}: {error}"
        ) from None
    return module


def _class_in(module: ModuleType, class_name: str, name: str) -> type[Eavesdropper]:
    found = getattr(module, class_name, None)
    if not (isinstance(found, type) and issubclass(found, Eavesdropper)):
        raise KnowledgeError(
            f"eavesdropper: got {name!r}, expected a class {class_name} that extends "
            "tap_service.eavesdroppers.Eavesdropper"
        )
    own = getattr(found, "name", None)
    if not (isinstance(own, str) and re.fullmatch(r"[\w.-]{1,64}", own)):
        raise KnowledgeError(
            f"eavesdropper: {name!r}: expected a class attribute name of 1 to 64 letters, digits, "
            f"dots, dashes or underscores, got {own!r}"
        )
    return found
