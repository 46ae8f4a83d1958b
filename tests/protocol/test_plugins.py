"""Plug-ins: what fails to load says why, each time; files of one stem are two modules."""

import pickle
import sys
from pathlib import Path

import pytest

from protocol.plugins import UnknownError, load, module_at


def test_what_cannot_be_loaded_names_its_cause_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shipped module as a user's file: and what is missing may be there at the next look."""
    monkeypatch.syspath_prepend(tmp_path)
    text = "import library_that_is_not_there\nclass Second:\n    pass\n"
    (tmp_path / "shipped_of_a_test.py").write_text(text)
    (tmp_path / "own.py").write_text(text)
    shipped = {"first": "protocol.text:readable", "second": "shipped_of_a_test:Second"}
    for name in ("second", f"{tmp_path / 'own.py'}:Second") * 2:
        with pytest.raises(UnknownError, match="No module named 'library_that_is_not_there'"):
            load(name, shipped)
    (tmp_path / "library_that_is_not_there.py").touch()
    for name in ("second", f"{tmp_path / 'own.py'}:Second"):
        assert load(name, shipped) is load(name, shipped)
        assert load(name, shipped).__name__ == "Second"
    with pytest.raises(UnknownError, match=r"got 'third', expected first, second or path/to/file"):
        load("third", shipped)


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
        found += [load(f"{path}:Both", {}), load(f"{path}:{name.title()}", {})]
    for kind in found:
        assert isinstance(kind, type)
        assert getattr(sys.modules[kind.__module__], kind.__name__) is kind
        assert pickle.loads(pickle.dumps(kind())) == kind()
    assert found[0] is not found[2]
    assert found[0].__module__ == found[1].__module__, "one file is read once"
    assert module_at(str(tmp_path / "one" / "mine.py"))[0].One().where.endswith("one/mine.py")
