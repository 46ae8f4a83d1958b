"""Registries: what can be named in a file or on a command line, and what each name stands for."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Generic, TypeVar

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
