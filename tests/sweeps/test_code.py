"""The version of the code: what it means changes it, and what is said about it does not."""

import ast
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from tests.support.programs import python
from wyner.sweeps import code
from wyner.sweeps.code import DOORS, LOOP, ROOMS, TAPS, code_of, meaning, same_code

A = '''"""What it is."""

from protocol.b import LIMIT

WORDS = "words.txt"
"""Where they stand."""


def f(x: float) -> float:
    """What it does."""
    from protocol.lazy import more  # only here

    return more(x) + LIMIT


TABLE = {"own": "protocol.named:Class"}
SHIPPED = "paper"
'''


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small project with the module that hashes it."""
    files = {
        "studies/a.py": A,
        "studies/words.txt": "one",
        "protocol/b.py": "LIMIT = 1",
        "protocol/lazy.py": "def more(x): return x",
        "protocol/named.py": "class Class: pass",
        "protocol/other.py": "",
        "runtime/door.py": "",
        "wyner/sweeps/code.py": Path(code.__file__).read_text(),
        "runtime/scenarios/paper.toml": 'description = "old"\nalpha = 8.0\n',
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def version(tree: Path) -> str:
    spec = spec_from_file_location("code_of_a_tree", tree / "wyner" / "sweeps" / "code.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return str(module.code_version("studies.a"))


@pytest.mark.parametrize(
    ("file", "change", "same"),
    [
        ("studies/a.py", lambda s: s.replace("What it is", "Other words"), True),
        ("studies/a.py", lambda s: s.replace("Where they stand", "Other words"), True),
        ("studies/a.py", lambda s: s.replace("What it does", "Other words"), True),
        ("studies/a.py", lambda s: s.replace('    """What it does."""\n', ""), True),
        ("studies/a.py", lambda s: s.replace("  # only here", ""), True),
        ("studies/a.py", lambda s: s.replace("more(x) + LIMIT", "(more(x)\n + LIMIT)"), True),
        ("studies/a.py", lambda s: s.replace("+ LIMIT", "- LIMIT"), False),
        ("studies/a.py", lambda s: s.replace('"own"', '"mine"'), False),
        ("studies/words.txt", lambda s: "two", False),
        ("protocol/b.py", lambda s: "LIMIT = 2", False),
        ("protocol/lazy.py", lambda s: s.replace("return x", "return 2 * x"), False),
        ("protocol/named.py", lambda s: s.replace("pass", "x = 1"), False),
        ("protocol/other.py", lambda s: "x = 1", True),
        ("runtime/door.py", lambda s: "x = 1", True),
        ("runtime/scenarios/paper.toml", lambda s: s.replace("old", "new") + "# said", True),
        ("runtime/scenarios/paper.toml", lambda s: s.replace("8.0", "3.0"), False),
    ],
)
def test_meaning_alone_changes_the_version(
    tree: Path, file: str, change: Callable[[str], str], same: bool
) -> None:
    before, text = version(tree), (tree / file).read_text()
    changed = change(text)
    assert changed != text
    (tree / file).write_text(changed)
    assert same_code(version(tree), before) == same


def test_versions_of_one_code_are_told_from_those_without_a_hash() -> None:
    assert same_code("1.0.0+aa", "1.1.0+aa")
    assert not same_code("1.0.0+aa", "1.0.0+bb")
    assert not same_code("0.1.0", "0.1.0")


def imported(statement: str) -> set[str]:
    done = python("-c", f"{statement}; import sys; print(*sys.modules, sep='\\n')")
    return {name for name in done.stdout.splitlines() if name.partition(".")[0] in ROOMS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statement", "module", "doors"),
    [
        (
            "from wyner.sweeps.running import run_task;"
            "from runtime.scenario_file import scenario_of;"
            "run_task(scenario_of('sustained').model_dump_json(), [8.0], 1, 0, 1, 9)",
            LOOP,
            DOORS | TAPS | {"protocol.text"},  # loaded by `runtime` alone, for its log
        ),
        (
            "from wyner.sweeps.running import run_task;"
            "from runtime.scenario_file import scenario_of;"
            "s = scenario_of('packed').model_dump_json();"
            "run_task(s, [8.0], 1, 0, 1, 9, ['list-decoder', 'text'], 'Hi')",
            LOOP,
            DOORS,
        ),
        (
            "from studies.secrecy.study import Task, measure;"
            "[measure(Task('ladder', 'clear', tap, 0, 9)) for tap in ('learning', 'oracle')]",
            "studies.secrecy.study",
            DOORS,
        ),
        (
            "from studies.attacks.study import Task, measure;"
            "list(measure(Task('bus', 'covert, 0.3', ('keyed-coin',), 'secret', runs=4)))",
            "studies.attacks.study",
            DOORS,
        ),
    ],
)
def test_the_version_covers_what_a_measurement_imports(
    statement: str, module: str, doors: frozenset[str]
) -> None:
    behind = {name for name in imported(statement) if not set(_prefixes(name)) & doors}
    behind = {name for name in behind if f"*.{name.rpartition('.')[2]}" not in doors}
    assert behind - set(code_of((module,), doors)) == set()
    assert len(behind) > 40


def _prefixes(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:length]) for length in range(1, len(parts) + 1)]


def test_an_empty_end_of_an_f_string_is_no_meaning() -> None:
    """Python 3.12.1 has one where others have none."""
    text = ast.parse("f'{x:.3f} s'")
    before = meaning(text)
    for node in ast.walk(text):
        if isinstance(node, ast.JoinedStr):
            node.values.append(ast.Constant(""))
    assert meaning(text) == before
