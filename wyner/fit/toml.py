"""A scenario's tables as a TOML file."""

import json
from collections.abc import Iterator, Mapping
from typing import Any


def as_toml(tables: Mapping[str, Any], head: str = "") -> str:
    """Tables of strings, numbers, booleans, arrays, tables and arrays of tables as TOML.

    Parameters
    ----------
    tables : mapping
    head : str
        Lines of comment.
    """
    lines = [f"# {line}".rstrip() for line in head.splitlines()]
    return "\n".join([*lines, *_table("", tables)]).strip() + "\n"


def _table(path: str, table: Mapping[str, Any]) -> Iterator[str]:
    """What is no table stands first; ``path`` is empty, or ends with a dot."""
    below: list[tuple[str, str, Mapping[str, Any]]] = []
    for key, value in table.items():
        name = f"{path}{key}"
        if isinstance(value, Mapping):
            below.append((f"[{name}]", name, value))
        elif isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
            below += [(f"[[{name}]]", name, item) for item in value]
        else:
            yield f"{key} = {json.dumps(value, ensure_ascii=False)}"
    for title, name, one in below:
        yield from ("", title, *_table(f"{name}.", one))
