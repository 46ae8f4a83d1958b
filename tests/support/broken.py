"""Wrong programs that the tests must notice: the real source with one place written otherwise."""

import inspect
from types import FunctionType, ModuleType
from typing import Any

import pytest

from protocol.link.effects import Effect, Effects, Publish, Save
from runtime.perform import Do, perform

FIRST_COPY = ("self._left = True  # copy 0", "self._left = False  # copy 0")
"""In the plant's stepper: a process that was started again takes its next copy for the first."""


def broken(patch: pytest.MonkeyPatch, module: ModuleType, right: str, wrong: str) -> None:
    """Run ``module`` with ``wrong`` in place of ``right``, for as long as ``patch`` lasts.

    The functions in which the text stands are replaced where they are: whoever has imported the
    module, or an object of its classes, has the wrong ones from then on.

    Parameters
    ----------
    patch : MonkeyPatch
    module : ModuleType
    right : str
        Stands in the source just once.
    wrong : str
        On as many lines.
    """
    source = inspect.getsource(module)
    assert source.count(right) == 1, f"{module.__name__}: {source.count(right)} times {right!r}"
    assert wrong.count("\n") == right.count("\n"), "expected the lines below to stay where they are"
    scope: dict[str, Any] = {"__name__": module.__name__, "__file__": module.__file__}
    exec(compile(source.replace(right, wrong), str(module.__file__), "exec"), scope)
    found = 0
    for name, made in scope.items():
        if getattr(made, "__module__", None) != module.__name__:
            continue
        there = getattr(module, name)
        if isinstance(made, FunctionType):
            found += _replace(patch, module, name, there, made, module)
        elif isinstance(made, type):
            for attribute, value in vars(made).items():
                if isinstance(value, FunctionType):
                    of = vars(there).get(attribute)
                    found += _replace(patch, there, attribute, of, value, module)
    assert found, f"{module.__name__}: {right!r} stands in no function"


def _replace(
    patch: pytest.MonkeyPatch,
    owner: object,
    name: str,
    there: object,
    made: FunctionType,
    module: ModuleType,
) -> bool:
    """Put a function in place of one that says something else; whether it does."""
    if not isinstance(there, FunctionType) or there.__code__ == made.__code__:
        return False
    function = FunctionType(
        made.__code__, vars(module), made.__name__, made.__defaults__, there.__closure__
    )
    function.__kwdefaults__ = made.__kwdefaults__
    patch.setattr(owner, name, function)
    return True


def hasty(effects: Effects, do: Do) -> None:
    """A wrong shell, which sends before it saves."""
    held: list[Effect] = []
    for effect in effects:
        if isinstance(effect, Save):
            held.append(effect)
            continue
        do(effect)
        if isinstance(effect, Publish):
            perform(held, do)
            held.clear()
    perform(held, do)
