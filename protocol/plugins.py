"""Plug-ins: what can be named in a file or on a command line, and what each name stands for.

A name is a shipped one, of a table ``{name: "module:Class"}``, or a class in a file of the user's,
``path/to/file.py:Name``. Nothing is loaded before it is asked for.
"""

import hashlib
import re
import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, TypeVar

T = TypeVar("T")


class UnknownError(LookupError):
    """A name that stands for nothing; the message, one line, lists those that do."""


def load(name: str, shipped: Mapping[str, str]) -> Any:
    """What a name stands for.

    Parameters
    ----------
    name : str
        One of ``shipped``, or ``path/to/file.py:Name`` with the path from the working folder.
    shipped : mapping
        Names with ``module:Class``.

    Returns
    -------
    Any
        None where the file has nothing of that name.

    Raises
    ------
    UnknownError
        When there is no such name or file, or it cannot be loaded.
    """
    if name not in shipped and not names_a_file(name):
        known = ", ".join(shipped)
        raise UnknownError(f"got {name!r}, expected {known} or path/to/file.py:Name")
    where, _, attribute = shipped.get(name, name).rpartition(":")
    return getattr(_read_once(where)[0], attribute, None)


def load_class(name: str, shipped: Mapping[str, str], base: type[T]) -> type[T]:
    """The class that a name stands for, as :func:`load` finds it.

    Raises
    ------
    UnknownError
        When there is none, it does not extend ``base``, it lacks methods, or its class attribute
        ``name`` is none.
    """
    return checked_class(load(name, shipped), name, base)


def checked_class(found: object, name: str, base: type[T]) -> type[T]:
    """``found``, where it is such a class, and ``name`` what it is called in a line.

    Raises
    ------
    UnknownError
        When it does not extend ``base``, lacks methods, or its class attribute ``name`` is none.
    """
    if not (isinstance(found, type) and issubclass(found, base)):
        what = f"{base.__module__}.{base.__name__}"
        class_name = name.rpartition(":")[2]
        raise UnknownError(f"got {name!r}, expected a class {class_name} that extends {what}")
    own = getattr(found, "name", None)
    if not (isinstance(own, str) and re.fullmatch(r"[\w.-]{1,64}", own)):
        raise UnknownError(
            f"{name!r}: expected a class attribute name of 1 to 64 letters, digits, dots, "
            f"dashes or underscores, got {own!r}"
        )
    if missing := ", ".join(sorted(getattr(found, "__abstractmethods__", ()))):
        raise UnknownError(f"got {name!r}, expected the methods that it lacks: {missing}")
    return found


def names_a_file(name: str) -> bool:
    """Whether ``name`` is of the form ``path/to/file.py:Name``."""
    where, colon, _ = name.rpartition(":")
    return bool(colon) and where.endswith(".py")


def source_of(name: str) -> str:
    """SHA-256 (hex) of the user's file that ``name`` names a class of; empty for any other name.

    It is of the text that runs. Modules that the file imports are not in it.
    """
    return _read_once(name.rpartition(":")[0])[1] if names_a_file(name) else ""


_READ: dict[Path, tuple[ModuleType, str]] = {}


def _read_once(where: str) -> tuple[ModuleType, str]:
    """As :func:`module_at`; a file is read once in a process, so what is hashed is what runs."""
    path = Path(where).resolve()
    if path not in _READ:
        _READ[path] = module_at(where)
    return _READ[path]


def module_at(where: str, folder: Path = Path()) -> tuple[ModuleType, str]:
    """The module that ``where`` names, ``file.py`` in ``folder`` or ``package.module``.

    Returns
    -------
    tuple of module and str
        The SHA-256 (hex) of the file that ran; empty for a module that is imported by its name.

    Raises
    ------
    UnknownError
        When it is not there, or cannot be loaded; one line that names the cause.
    """
    path = folder / where
    try:
        return _run_file(path) if where.endswith(".py") else (import_module(where), "")
    except FileNotFoundError:
        beside = "" if path.is_absolute() else f" in {Path.cwd()}"
        raise UnknownError(f"{path}: no such file{beside}") from None
    except ModuleNotFoundError as error:
        raise UnknownError(f"{where}: {error}") from None
    except (Exception, SystemExit) as error:  # what a user's code raises is told in one line
        raise UnknownError(f"{where}: cannot be loaded: {type(error).__name__}: {error}") from error


def _run_file(path: Path) -> tuple[ModuleType, str]:
    """The module, and the SHA-256 (hex) of the bytes that ran."""
    if not path.is_file():
        raise FileNotFoundError(path)
    where = path.resolve()
    stem = re.sub(r"\W", "_", path.stem)
    digest = hashlib.sha256(str(where).encode(errors="surrogateescape")).hexdigest()
    name = f"own_{stem}_{digest[:8]}"  # two files may have one stem
    spec = spec_from_file_location(name, where, loader=_OnceRead(name, where))
    assert spec is not None
    assert isinstance(spec.loader, _OnceRead)
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # a dataclass looks its own module up there, and so does pickle
    spec.loader.exec_module(module)
    return module, hashlib.sha256(spec.loader.text).hexdigest()


class _OnceRead(SourceFileLoader):
    """Runs the text that it has read, and no compiled one of a file that has changed since."""

    def __init__(self, name: str, path: Path) -> None:
        super().__init__(name, str(path))
        self.text = path.read_bytes()

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        return self.source_to_code(self.text, self.path)
