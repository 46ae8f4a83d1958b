"""A secret message inside a control loop: the command ``wyner``, and the library of the same name.

``from wyner import design, run`` loads :mod:`wyner.api` on first use; the command, which
imports this package too, never does.
"""

import runtime.early as _early  # noqa: F401

TYPE_CHECKING = False
"""As `typing` has it, which is not loaded for that."""

if TYPE_CHECKING:
    from wyner.api import *  # noqa: F403


def __getattr__(name: str) -> object:
    """What the library exports, loaded when it is asked for (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        return version("wyner")
    if name == "__all__" or not name.startswith("_"):
        from importlib import import_module

        api = import_module("wyner.api")
        if name in (*api.__all__, "__all__"):
            found: object = getattr(api, name)
            return found
    raise AttributeError(f"module 'wyner' has no attribute {name!r}")
