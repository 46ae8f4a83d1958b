"""Which code numbers come from: a hash of what it means, whatever its comments and docstrings say.

A module's code is its own syntax tree and that of every module that it imports, at its head or in
a function, or names in a table of what can be loaded (``"package.module:Class"``). The search ends
at :data:`DOORS`.
"""

import ast
import hashlib
import json
import re
import tomllib
from collections.abc import Collection, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]

ROOMS: Final = frozenset(
    ("attacker_service", "controller_service", "plant_service", "protocol", "runtime", "studies",
     "tap_service", "tests", "wyner")
)  # fmt: skip
"""The project's packages: what is imported from elsewhere has versions of its own."""

DOORS: Final = frozenset(
    ("runtime", "wyner.api", "wyner.sweeps.workers", "protocol.brief", "protocol.text",
     "*.__main__", "*.command", "*.service")
)  # fmt: skip
"""No number of a simulation comes from behind them: processes, files and buses, the services with
their command lines, and how objects are shown. A test runs a study and looks what it imported."""

_NAMES_A_MODULE: Final = re.compile(r"[a-z_]\w*(\.\w+)+(:\w+)?")
_NAMES_A_FILE: Final = re.compile(r"[\w-]+(\.\w+)+")


LOOP: Final = f"{__package__}.running"
"""What simulates a sweep's runs."""

TAPS: Final = frozenset(("tap_service", "wyner.simulate.engine.taps"))
"""What a sweep's numbers come from besides where somebody listens."""


def loop_version() -> str:
    """Of the code of a sweep to which nobody listens."""
    return code_version(LOOP, without=DOORS | TAPS)


def code_version(*modules: str, without: Collection[str] = DOORS) -> str:
    """The package's version, and a hash of the code of these modules.

    Parameters
    ----------
    modules : str
        By their dotted names.
    without : collection of str
        Modules at which the search ends; ``*.NAME`` are those of that name in any package.
    """
    return f"{version('wyner')}+{_digest(modules, frozenset(without))}"


def same_code(one: str, other: str) -> bool:
    """Whether two versions are of the same code, whatever the package was called then."""
    return one.partition("+")[2] == other.partition("+")[2] != ""


@cache
def _digest(modules: tuple[str, ...], without: frozenset[str]) -> str:
    digest = hashlib.blake2b(digest_size=4)
    for name in code_of(modules, without):
        digest.update(f"{name} {_hash_of(name)}".encode())
    return digest.hexdigest()


@cache
def code_of(modules: tuple[str, ...], without: frozenset[str] = DOORS) -> tuple[str, ...]:
    """The names of all modules of the project whose code these are, sorted."""
    found: set[str] = set()
    todo = list(modules)
    while todo:
        parts = todo.pop().split(".")
        for length in range(1, len(parts) + 1):
            name = ".".join(parts[:length])
            if _is_door(name, without):
                break
            if name not in found and _file_of(name) is not None:
                found.add(name)
                todo += _named_in(name)
    return tuple(sorted(found))


def _is_door(name: str, doors: Collection[str]) -> bool:
    return name in doors or f"*.{name.rpartition('.')[2]}" in doors


@cache
def _file_of(name: str) -> Path | None:
    if name.partition(".")[0] not in ROOMS:
        return None
    path = ROOT / name.replace(".", "/")
    return next((f for f in (path.with_suffix(".py"), path / "__init__.py") if f.is_file()), None)


@cache
def _tree_of(name: str) -> ast.Module:
    path = _file_of(name)
    assert path is not None
    return ast.parse(path.read_bytes())


@cache
def _named_in(name: str) -> frozenset[str]:
    """The modules that a module imports or names, those of others among them."""
    return frozenset(_names(_tree_of(name)))


def _names(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return
        case ast.Import(names=names):
            yield from (alias.name for alias in names)
        case ast.ImportFrom(module=str(module), names=names):
            yield from (f"{module}.{alias.name}" for alias in names)
        case ast.Constant(value=str(text)) if _NAMES_A_MODULE.fullmatch(text):
            yield text.partition(":")[0]
    for child in ast.iter_child_nodes(node):
        yield from _names(child)


@cache
def _hash_of(name: str) -> str:
    """Of what a module means, and of the data files beside it that it names.

    A study's module also has the shipped scenarios that it names.
    """
    path = _file_of(name)
    assert path is not None
    tree = _tree_of(name)
    digest = hashlib.blake2b(meaning(tree).encode(), digest_size=8)
    for text in sorted(_texts(tree)):
        if _NAMES_A_FILE.fullmatch(text) and (path.parent / text).is_file():
            digest.update((path.parent / text).read_bytes())
        if name.startswith("studies."):
            digest.update(_scenario(text))
    return digest.hexdigest()


def _texts(tree: ast.Module) -> set[str]:
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {node.value for node in constants if isinstance(node.value, str)}


def _scenario(name: str) -> bytes:
    path = ROOT / "runtime" / "scenarios" / f"{name}.toml"
    if not re.fullmatch(r"[\w-]+", name) or not path.is_file():
        return b""
    fields = tomllib.loads(path.read_text(encoding="utf-8"))
    fields.pop("description", None)
    return json.dumps(fields, sort_keys=True).encode()


def meaning(node: object) -> str:
    """A syntax tree as text, without its docstrings; the same under every Python."""
    if isinstance(node, list):
        return f"[{' '.join(meaning(one) for one in node if not _is_remark(one))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    if isinstance(node, ast.JoinedStr):  # one Python ends some f-strings with an empty text
        node = ast.JoinedStr([v for v in node.values if meaning(v) != "Constant(value='')"])
    fields = (
        f"{name}={meaning(value)}"
        for name, value in ast.iter_fields(node)
        if value is not None and value != [] and name not in ("ctx", "kind", "type_comment")
    )
    return f"{type(node).__name__}({' '.join(fields)})"


def _is_remark(node: object) -> bool:
    """Whether a statement is a text alone: a docstring, or what stands below a constant."""
    match node:
        case ast.Expr(value=ast.Constant(value=str())):
            return True
    return False
