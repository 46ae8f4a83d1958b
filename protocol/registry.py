"""Registries: what can be named in a file or on a command line, and what each name stands for."""

import hashlib
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Generic, NamedTuple, TypeVar, cast

T = TypeVar("T")


class UnknownError(LookupError):
    """A name that a registry does not know; the message lists those that it does."""


PROVIDERS: dict[str, list[str]] = {}
"""Modules to be imported before the first look-up of a kind of thing."""


def provide(what: str, module: str) -> None:
    """Have ``module`` imported before the first look-up of a ``what``; it registers its entries.

    A package states this in its ``__init__``, which stays light: nothing is loaded before it is
    asked for.
    """
    PROVIDERS.setdefault(what, []).append(module)


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
        self._loading: set[str] = set()
        self._own: Callable[[str, OwnClass], T] | None = None

    def take_own(self, entry: Callable[[str, "OwnClass"], T]) -> None:
        """Take classes in files of the user's as well, ``path/to/file.py:Name``.

        Parameters
        ----------
        entry : callable
            Makes the entry of a name and what stands in the file; UnknownError where it is none.
        """
        self._own = entry

    def source(self, name: str) -> str:
        """SHA-256 (hex) of the user's file that ``name`` names a class of; empty for any other.

        It is of the text that runs: the file as it was when its class was first asked for.
        """
        return own_class(name).sha256 if names_a_file(name) and name not in self._entries else ""

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
        if name in entries:
            return entries[name]
        if self._own is not None and names_a_file(name):
            return self._own(name, own_class(name))
        known = ", ".join(entries) or "none"
        or_own = "" if self._own is None else ", or path/to/file.py:Name"
        raise UnknownError(f"got {name!r}, expected a {self.what}: {known}{or_own}")

    def __contains__(self, name: object) -> bool:
        return name in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    @property
    def served(self) -> bool:
        """Whether this process knows entries: a room that provides them was imported."""
        return self.what in PROVIDERS or bool(self._entries)

    def _all(self) -> dict[str, T]:
        modules = PROVIDERS.get(self.what, [])
        while (module := next((m for m in modules if m not in self._loading), None)) is not None:
            before = dict(self._entries)
            self._loading.add(module)
            try:
                import_module(module)
            except BaseException:  # it stays, and the next look-up fails with the same cause
                self._entries = before
                raise
            finally:
                self._loading.discard(module)
            modules.remove(module)
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
        self.take_own(lambda name, own: self._checked(name, own.found, own.name))

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
        if names_a_file(name) and name not in self._entries:
            return super().__getitem__(name)
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
        return [*self.shipped, *(n for n in self._entries if n not in self.shipped)]

    def _find(self, name: str) -> type[T]:
        if name in self.shipped:
            where, _, class_name = self.shipped[name].partition(":")
            return self._checked(name, getattr(import_module(where), class_name), class_name)
        known = ", ".join(self)
        raise UnknownError(f"got {name!r}, expected {known} or path/to/file.py:Name")

    def checked(self, name: str, found: object) -> type[T]:
        """A class that has all that one of this kind needs.

        Raises
        ------
        UnknownError
            When it is no class of this kind, or lacks its name or a method.
        """
        return self._checked(name, found, name)

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
        missing = sorted(getattr(found, "__abstractmethods__", ()))
        if missing:
            lacks = ", ".join(missing)
            raise UnknownError(f"got {name!r}, expected the methods that it lacks: {lacks}")
        return cast("type[T]", found)


class OwnClass(NamedTuple):
    """What a file of the user's calls ``name``, and the SHA-256 (hex) of the file that ran."""

    name: str
    found: object
    sha256: str


_OWN: dict[Path, tuple[ModuleType, str]] = {}


def names_a_file(name: str) -> bool:
    """Whether ``name`` is of the form ``path/to/file.py:Name``."""
    where, colon, _ = name.rpartition(":")
    return bool(colon) and where.endswith(".py")


def own_class(name: str) -> OwnClass:
    """What ``path/to/file.py:Name`` names; the path is taken from the working folder.

    A file is read once in a process, so what is hashed is what runs. Modules that it imports are
    not in the hash.

    Raises
    ------
    UnknownError
        When there is no such file, or it cannot be loaded.
    """
    where, _, class_name = name.rpartition(":")
    path = Path(where).resolve()
    if path not in _OWN:
        _OWN[path] = module_at(where)
    module, sha256 = _OWN[path]
    return OwnClass(class_name, getattr(module, class_name, None), sha256)


def module_at(where: str, folder: Path = Path()) -> tuple[ModuleType, str]:
    """The module that ``where`` names, ``file.py`` in ``folder`` or ``package.module``.

    Returns
    -------
    tuple of module and str
        The SHA-256 (hex) of the file that ran; empty for a module that is imported by its name.

    Raises
    ------
    UnknownError
        When it is not there, or cannot be loaded; one line.
    """
    path = folder / where
    try:
        return _run_file(path) if where.endswith(".py") else (import_module(where), "")
    except FileNotFoundError:
        where = "" if path.is_absolute() else f" in {Path.cwd()}"
        raise UnknownError(f"{path}: no such file{where}") from None
    except ModuleNotFoundError as error:
        raise UnknownError(f"{where}: {error}") from None
    except Exception as error:  # the code is the user's: what it raises is told in one line
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
