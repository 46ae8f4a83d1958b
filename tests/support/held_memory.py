"""How much is reachable from some objects: for tests that nothing grows."""

import gc
import sys
from collections.abc import Iterable
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Final

PROGRAM: Final = (type, ModuleType, FunctionType, BuiltinFunctionType, CodeType)


def kept(roots: Iterable[object], elsewhere: tuple[type, ...] = ()) -> tuple[int, int]:
    """Objects that are reachable from some, and their bytes.

    Programs are left out, and what is reachable through one of the types ``elsewhere`` alone.
    """
    seen: dict[int, object] = {}
    todo = list(roots)
    while todo:
        one = todo.pop()
        if id(one) not in seen and not isinstance(one, (*PROGRAM, *elsewhere)):
            seen[id(one)] = one
            todo += gc.get_referents(one)
    return len(seen), sum(map(sys.getsizeof, seen.values()))
