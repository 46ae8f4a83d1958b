"""A secret message inside a control loop: the command ``wyner``, and the library of the same name.

``from wyner import design, run`` loads :mod:`wyner.api` on first use; the command, which
imports this package too, never does.
"""

# Ctrl-C comes before anything of Python's library. Then each says which laws, services and plants
# it brings; none of them loads more than that.
import runtime.early as _early  # noqa: F401, I001
import controller_service as _controller_service  # noqa: F401
import plant_service as _plant_service  # noqa: F401
import tap_service as _tap_service  # noqa: F401
from protocol.registry import provide as _provide

_provide("service", "wyner.clients")

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
