"""Tests hold behaviour: none reaches into the private parts of another module."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]

PUBLIC = {"_replace", "_asdict", "_fields", "_make", "_exit", "_repr_html_"}
"""Public by their own documentation: of named tuples, of `os`, of notebooks."""


def own(tree: ast.Module) -> set[str]:
    """Private names that a file defines itself, its classes' attributes among them."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name)
            and node.value.id == "self"
        ):
            names.add(node.attr)
    return names


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name not in PUBLIC


def private_parts(text: str) -> Iterator[str]:
    """Every private part of another module that a test's text names."""
    tree = ast.parse(text)
    mine = own(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr) and node.attr not in mine:
            yield f"line {node.lineno}: {ast.unparse(node)}"
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if is_private(alias.name):
                    yield f"line {node.lineno}: {node.module}.{alias.name}"
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("attr"):
            # getattr, setattr, and monkeypatch's
            for word in node.args:
                if isinstance(word, ast.Constant) and isinstance(word.value, str):
                    name = word.value.rpartition(".")[2]
                    if is_private(name) and name not in mine:
                        yield f"line {node.lineno}: {word.value!r}"


def test_it_sees_each_way_in() -> None:
    text = """
from a import _b
c._d.e
monkeypatch.setattr(a, "_f", 1)
getattr(a, "_g")
class Mine:
    def __init__(self): self._h = 1
Mine()._h
point._replace(x=1)
"""
    assert list(private_parts(text)) == [
        "line 2: a._b",
        "line 4: '_f'",
        "line 5: '_g'",
        "line 3: c._d",
    ]


@pytest.mark.parametrize("path", sorted(TESTS.rglob("*.py")), ids=lambda path: path.stem)
def test_no_test_reaches_into_private_parts(path: Path) -> None:
    found = list(private_parts(path.read_text(encoding="utf-8")))
    assert not found, "\n".join(found)
