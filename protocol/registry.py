"""Registries: what can be named in a file or on a command line, and what each name stands for."""

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Generic, TypeVar, cast

T = TypeVar("T")


class UnknownError(LookupError):
    """A name that a registry does not know; the message lists those that it does."""


_PROVIDERS: dict[str, list[str]] = {}


def provide(what: str, module: str) -> None:
    """Have ``module`` imported before the first look-up of a ``what``; it registers its entries.

    A package states this in its ``__init__``, which stays light: nothing is loaded before it is
    asked for.
    """
    _PROVIDERS.setdefault(what, []).append(module)


class Registry(Generic[T]):
    """Entries by name.

    Parameters
    ----------
    what : str
        What an entry is, for the messages: ``law``.
    """

    def __init__(self, what: str) -> None:
        self.what = what
        self._entries: dict[str, T] = {}

    def register(self, name: str, entry: T) -> T:
        """Add an entry.

        Raises
        ------
        ValueError
            When the name is taken by another entry.
        """
        if self._entries.setdefault(name, entry) is not entry:
            raise ValueError(f"{self.what} {name!r} stands there already")
        return entry

    @contextmanager
    def registered(self, name: str, entry: T) -> Iterator[T]:
        """Within the block, ``entry`` is registered."""
        self._all()
        try:
            yield self.register(name, entry)
        finally:
            del self._entries[name]

    def __getitem__(self, name: str) -> T:
        entries = self._all()
        if name not in entries:
            known = ", ".join(entries) or "none"
            raise UnknownError(f"got {name!r}, expected a {self.what}: {known}")
        return entries[name]

    def __contains__(self, name: object) -> bool:
        return name in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def _all(self) -> dict[str, T]:
        modules = _PROVIDERS.get(self.what, [])
        while modules:
            import_module(modules.pop(0))
        return self._entries


class Classes(Registry[type[T]]):
    """Classes by name, each loaded when it is first asked for; also from a file of the user's.

    ``classes["path/to/file.py:Name"]`` is the class ``Name`` of that file.

    Parameters
    ----------
    what : str
    base : type
        What each of them extends; every one has a class attribute ``name``.
    shipped : mapping
        Names with ``module:Class``.
    """

    def __init__(self, what: str, base: type, shipped: Mapping[str, str]) -> None:
        super().__init__(what)
        self.base = base
        self.shipped = dict(shipped)

    def register(self, name: str, entry: type[T]) -> type[T]:
        """Add a class.

        Raises
        ------
        ValueError
            When the name is taken by another.
        UnknownError
            When it is no class of this kind.
        """
        if name in self.shipped:
            raise ValueError(f"{self.what} {name!r} stands there already")
        return super().register(name, self._checked(name, entry, name))

    def __getitem__(self, name: str) -> type[T]:
        if name not in self._entries:
            self._entries[name] = self._find(name)
        return self._entries[name]

    def __contains__(self, name: object) -> bool:
        return name in self._names()

    def __iter__(self) -> Iterator[str]:
        return iter(self._names())

    def __len__(self) -> int:
        return len(self._names())

    def _names(self) -> list[str]:
        return [
            *self.shipped,
            *(n for n in self._entries if n not in self.shipped and ":" not in n),
        ]

    def _find(self, name: str) -> type[T]:
        if name in self.shipped:
            where, _, class_name = self.shipped[name].partition(":")
            return self._checked(name, getattr(import_module(where), class_name), class_name)
        where, colon, class_name = name.rpartition(":")
        if not colon or not where.endswith(".py"):
            known = ", ".join(self)
            raise UnknownError(f"got {name!r}, expected {known} or path/to/file.py:Name")
        try:
            module = load_file(Path(where))
        except FileNotFoundError:
            raise UnknownError(f"got {name!r}, expected an existing Python file") from None
        except Exception as error:  # the file is the user's: what it raises is told in one line
            problem = f"{type(error).__name__}: {error}"
            raise UnknownError(f"{where}: cannot be loaded: {problem}") from None
        return self._checked(name, getattr(module, class_name, None), class_name)

    def _checked(self, name: str, found: object, class_name: str) -> type[T]:
        if not (isinstance(found, type) and issubclass(found, self.base)):
            base = f"{self.base.__module__}.{self.base.__name__}"
            raise UnknownError(f"got {name!r}, expected a class {class_name} that extends {base}")
        own = getattr(found, "name", None)
        if not (isinstance(own, str) and re.fullmatch(r"[\w.-]{1,64}", own)):
            raise UnknownError(
                f"{name!r}: expected a class attribute name of 1 to 64 letters, digits, dots, "
                f"dashes or underscores, got {own!r}"
            )
        return cast("type[T]", found)


def load_file(path: Path) -> ModuleType:
    """A Python file of the user's, as a module.

    Raises
    ------
    FileNotFoundError
    Exception
        Whatever the file raises.
    """
    if not path.is_file():
        raise FileNotFoundError(path)
    stem = re.sub(r"\W", "_", path.stem)
    spec = spec_from_file_location(f"own_{stem}", path.resolve())
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # a dataclass looks its own module up there, and so does pickle
    spec.loader.exec_module(module)
    return module
