"""The reference of the scenario file, made from the models that read it.

``python -m tools.scenario_reference`` prints it, and the site is built with it (``docs/conf.py``).
A field's line is the string that stands below it in its class.
"""

import ast
import inspect
import json
import textwrap
import types
import typing
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from protocol.scenario import LAWS, PLANTS, Control, PlantTable, Scenario, ScenarioTable

HEAD: Final = """# The scenario file

A scenario is a TOML file: a plant, its sets, its control law, and what each side knows.
`wyner design` lists the shipped scenarios, `wyner new NAME` writes a commented one, and
`wyner design FILE` computes its sets and rate. Unknown fields are refused, each in one line.

Vectors are lists of numbers, matrices lists of rows. n is the number of states, m of inputs, M of
candidates. States, inputs and disturbances are in the units of the plant's model, times in seconds,
probabilities from 0 to 1. A set is a box or a polytope, always with the origin inside:
`{ half_widths = [0.12, 0.12] }`, or `{ H = [[0.0, 1.0]], h = [2.0] }`.
"""


def missing() -> list[str]:
    """The fields without a line of their own."""
    return [
        f"{cls.__name__}.{name}"
        for _, cls in tables()
        for name in own_fields(cls)
        if not lines_of(cls).get(name)
    ]


def tables() -> Iterator[tuple[str, type[ScenarioTable]]]:
    """Every table of the file with its heading, in the order of a file."""
    yield "", Scenario
    for path, cls in _below("", Scenario):
        yield f"[{path}]", cls
        if cls is PlantTable:
            for name in PLANTS:
                yield f'[plant] of kind = "{name}", besides', PLANTS[name]
        if cls is Control:
            for name in LAWS:
                if own_fields(LAWS[name]):
                    yield f'[control] of law = "{name}", besides', LAWS[name]
                    yield from _headed("control", LAWS[name], known=Control)
        yield from _headed(path, cls)


def own_fields(cls: type[ScenarioTable]) -> list[str]:
    """The fields that a class has beside those of ``[plant]`` or ``[control]``, or tells anew."""
    common = [c for c in (PlantTable, Control) if c in cls.__mro__[1:]]
    told = {f for c in common for f in c.model_fields} - inspect.get_annotations(cls).keys()
    return [f for f in cls.model_fields if f not in told]


def _headed(
    path: str, cls: type[ScenarioTable], known: type[ScenarioTable] | None = None
) -> Iterator[tuple[str, type[ScenarioTable]]]:
    for below, part in _below(path, cls):
        if known is None or (below, part) not in list(_below(path, known)):
            yield f"[{below}]", part
            yield from _headed(below, part)


def _below(path: str, cls: type[ScenarioTable]) -> Iterator[tuple[str, type[ScenarioTable]]]:
    """The tables that a table's fields are, sets aside: those are values."""
    for name, field in cls.model_fields.items():
        for part in _parts(field.annotation):
            if part.__name__ != "ConvexSet":
                repeated = "tuple" in str(field.annotation)
                where = f"{path}.{name}" if path else name
                yield (f"[{where}]" if repeated else where), part


def _parts(annotation: Any) -> Iterator[type[ScenarioTable]]:
    if isinstance(annotation, type) and issubclass(annotation, ScenarioTable):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from _parts(inner)


@cache
def lines_of(cls: type[ScenarioTable]) -> dict[str, str]:
    """For each field the string below it, the class's own before those it inherits."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if base is BaseModel or not (isinstance(base, type) and issubclass(base, BaseModel)):
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for statement, after in zip(body.body, body.body[1:], strict=False):
            if isinstance(statement, ast.AnnAssign) and isinstance(after, ast.Expr):
                value = after.value
                if isinstance(value, ast.Constant) and isinstance(value.value, str):
                    assert isinstance(statement.target, ast.Name)
                    found[statement.target.id] = " ".join(value.value.split())
    return found


def form_of(annotation: Any, field: FieldInfo | None = None) -> str:
    """A field's type as a reader of TOML says it, with its bounds."""
    bounds = "".join(
        f" {sign} {getattr(m, name):g}"
        for m in (field.metadata if field else ())
        for name, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤"))
        if getattr(m, name, None) is not None
    )
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        inner = FieldInfo.from_annotation(annotation)
        return form_of(args[0], inner) + bounds
    if origin is Literal:
        return " or ".join(f"`{a!r}`".replace("'", '"') for a in args)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(form_of(a) for a in args if a is not type(None)) + bounds
    if origin is tuple:
        if not args:
            return "empty list"
        if args[-1] is not Ellipsis:
            return f"list of {len(args)} {_plural(form_of(args[0]))}"
        inner_form = form_of(args[0])
        if typing.get_origin(args[0]) is Literal:
            return f"list of {inner_form}"
        return "matrix" if inner_form == "list of numbers" else f"list of {_plural(inner_form)}"
    if origin is dict:
        return "table of values by name"
    if isinstance(annotation, type) and issubclass(annotation, ScenarioTable):
        return "set" if annotation.__name__ == "ConvexSet" else "table"
    names = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    return names.get(annotation, str(annotation)) + bounds


def _plural(form: str) -> str:
    word, _, rest = form.partition(" ")
    if word == "text":
        return "texts"
    return f"{word}s {rest}".strip() if word != "whole" else "whole numbers"


def default_of(field: FieldInfo) -> str:
    """The default as TOML has it."""
    if field.is_required():
        return "required"
    value = field.default
    if value is None or value in ((), ""):
        return "-"
    if isinstance(value, ScenarioTable) or (
        isinstance(value, tuple) and isinstance(value[0], ScenarioTable)
    ):
        return "see below" if isinstance(value, ScenarioTable) else "see its table"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return f"`{json.dumps(value)}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def page() -> str:
    """The whole page."""
    parts, seen = [HEAD], set()
    for heading, cls in tables():
        if (heading, cls) in seen:
            continue
        seen.add((heading, cls))
        about = (inspect.getdoc(cls) or "").split("\n\nParameters")[0]
        parts.append(f"## {f'`{heading}`' if heading else 'The file'}\n")
        parts.append(about.replace("``", "`").replace(":data:", "").replace(":class:", "") + "\n")
        rows = ["| field | value | default | |", "|---|---|---|---|"]
        for name in own_fields(cls):
            field = cls.model_fields[name]
            value = form_of(field.annotation, field)
            told = lines_of(cls).get(name, "").replace("|", "\\|")
            rows.append(f"| `{name}` | {value} | {default_of(field)} | {told} |")
        parts.append("\n".join(rows) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    print(page(), end="")
