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
    plain = {k: v for k, v in table.items() if not isinstance(v, Mapping) and not _tables(v)}
    for key, value in plain.items():
        yield f"{key} = {_value(value)}"
    for key, value in table.items():
        if key in plain:
            continue
        below = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            yield from ("", f"[{below}]")
            yield from _table(below, value)
        else:
            for item in value:
                yield from ("", f"[[{below}]]")
                yield from _table(below, item)


def _tables(value: object) -> bool:
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, ensure_ascii=False)
