"""Registries: what fails to load says why, each time; files of one stem are two modules."""

import pickle
import sys
from pathlib import Path

import pytest

from protocol import registry
from protocol.registry import Registry, UnknownError, module_at, own_class, provide

PROVIDER = """
from tests.protocol.test_registry import KINDS
KINDS.register("first", object())
import {missing}
KINDS.register("second", object())
"""
KINDS: Registry[object] = Registry("kind of this test")


def test_a_provider_that_cannot_be_loaded_is_named_at_every_look_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its names are there once it can: none of them is "unknown" meanwhile."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "PROVIDERS", {})
    provider = tmp_path / "provider_of_a_test.py"
    provider.write_text(PROVIDER.format(missing="library_that_is_not_there"))
    provide(KINDS.what, "provider_of_a_test")
    for _ in range(2):
        with pytest.raises(ModuleNotFoundError, match="library_that_is_not_there"):
            KINDS["second"]
        with pytest.raises(ModuleNotFoundError, match="library_that_is_not_there"):
            list(KINDS)
    (tmp_path / "library_that_is_not_there.py").touch()
    assert sorted(KINDS) == ["first", "second"]
    assert KINDS["second"] is KINDS["second"]
    with pytest.raises(UnknownError, match="expected a kind of this test: first, second"):
        KINDS["third"]


OWN = """
from dataclasses import dataclass
@dataclass
class {name}:
    where: str = __file__
@dataclass
class Both:
    where: str = __file__
"""


def test_two_files_of_one_stem_are_two_modules(tmp_path: Path) -> None:
    found = []
    for name in ("one", "other"):
        path = tmp_path / name / "mine.py"
        path.parent.mkdir()
        path.write_text(OWN.format(name=name.title()))
        found += [own_class(f"{path}:Both").found, own_class(f"{path}:{name.title()}").found]
    for kind in found:
        assert isinstance(kind, type)
        assert getattr(sys.modules[kind.__module__], kind.__name__) is kind
        assert pickle.loads(pickle.dumps(kind())) == kind()
    assert found[0] is not found[2]
    assert found[0].__module__ == found[1].__module__, "one file is read once"
    assert module_at(str(tmp_path / "one" / "mine.py"))[0].One().where.endswith("one/mine.py")
