"""Every key of every file that people write, from the settings' values: `python -m docs.keys`."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
import textwrap
import types
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from docs.marks import prose, table, write

DOCUMENT = Path(__file__).with_suffix(".md")
TEMPLATE = DOCUMENT.parent / "templates" / DOCUMENT.name
MODULE = "docs.keys"
KINDS = {
    "SensorError": "[a fault's](instruments.md#all-faults-and-their-places)",
    "Effect": "[an effect's](instruments.md#all-effects)",
}
"""Tables whose keys are their kind's."""
LARGEST = 1e15
"""A bound beyond this is the computer's and nobody's who writes a file."""
ONLY_IN_PYTHON = ("JointLaw",)
"""What no file can say, though a script can."""


def files() -> Mapping[str, type]:
    """What people write, and the value that it becomes."""
    from testbed.campaigns.campaign import CampaignTables
    from testbed.importing.mapping import Mapping as MappingFile
    from testbed.lab.experiment.experiment import Experiment

    return {
        "experiment": Experiment,
        "campaign": CampaignTables,
        "mapping": MappingFile,
    }


def as_markdown(of: str) -> str:
    """All tables of one kind of file.

    Args:
        of: The file's kind.
    """
    heads: dict[type, list[str]] = {}  # several tables may have the same keys
    for head, model in tables(files()[of], ""):
        heads.setdefault(model, []).append(head)
    lines: list[str] = []
    for model, same in heads.items():
        about = (inspect.getdoc(model) or "").split("\n\n")[0]
        if same != [""]:
            title = ", ".join(f"`{head}`" for head in same)
            lines += ["", f"### {title}", "", prose(" ".join(about.split()))]
        rows = [(f"`{name}`", *rest) for name, *rest in keys(model)]
        lines += ["", *table("key | what it takes | default | meaning", rows)]
    return "\n".join([*lines, "", ""])


def tables(model: type, path: str) -> Iterator[tuple[str, type]]:
    """A table and all tables in it, by their heads.

    Args:
        model: Of the table.
        path: Its own head, as "[robot]".
    """
    yield path, model
    inside = path.strip("[]")
    for name, annotation in hints(model).items():
        found = next((each for each in members(annotation) if is_table(each)), None)
        if found is not None:
            head = ".".join(filter(None, [inside, name, "NAME" * by_name(annotation)]))
            yield from tables(found, f"[[{head}]]" if listed(annotation) else f"[{head}]")


def keys(model: type) -> Iterator[tuple[str, str, str, str]]:
    """Name, what it takes, default and meaning of a table's keys.

    Args:
        model: Of the table.
    """
    said = meanings(model)
    for name, annotation in hints(model).items():
        if not any(is_table(each) for each in members(annotation)):
            meaning = " ".join(said.get(name, "").split())
            yield name, takes(annotation), default(model, name), prose(meaning)


def hints(model: type) -> dict[str, Any]:
    """Annotations of the keys, with their bounds."""
    if dataclasses.is_dataclass(model):
        found = get_type_hints(model, include_extras=True)
        return {each.name: found[each.name] for each in dataclasses.fields(model)}
    fields = model.model_fields  # type: ignore[attr-defined]
    return {
        name: Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        for name, field in fields.items()
    }


def meanings(model: type) -> dict[str, str]:
    """What is said of each key: under it, or in the class's list of attributes."""
    own = inspect.getdoc(model) or ""
    said = dict(re.findall(r"^    (\w+): ((?:.|\n {8})*)", own, re.MULTILINE))
    for kind in reversed(model.__mro__):
        if kind.__module__.startswith("testbed"):
            body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body  # type: ignore[attr-defined]
            for line, after in pairwise(body):
                if isinstance(line, ast.AnnAssign) and isinstance(after, ast.Expr):
                    said[line.target.id] = ast.literal_eval(after.value)  # type: ignore[union-attr]
    return said


def default(model: type, name: str) -> str:
    """What holds where nothing is said."""
    if dataclasses.is_dataclass(model):
        field: Any = next(each for each in dataclasses.fields(model) if each.name == name)
        factory, missing = field.default_factory, dataclasses.MISSING
        value = field.default if factory is missing else factory()
    else:
        known = model.model_fields[name]  # type: ignore[attr-defined]
        if known.is_required():
            return "required"
        value = known.get_default(call_default_factory=True)
    if value is None:
        return ""
    return f"`{json.dumps(value)}`" if value is not dataclasses.MISSING else "required"


def takes(annotation: Any) -> str:
    """What may stand under a key, in words."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        unit = "characters" if inner[0] is str else "items"
        return f"{takes(inner[0])}{bounds(inner[1:], unit)}"
    if origin in (Union, types.UnionType):
        kept = [each for each in inner if each is not type(None) and not in_python(each)]
        return " or ".join(dict.fromkeys(takes(each) for each in kept))
    if origin is Literal:
        return " or ".join(f"`{json.dumps(each)}`" for each in inner)
    if origin in (tuple, list, Sequence):
        several = origin is tuple and inner[-1] is not Ellipsis
        return f"{len(inner) if several else 'list'} of: {takes(inner[0])}"
    if origin in (dict, Mapping):
        return f"table by name: {takes(inner[1])}"
    names = {bool: "true or false", int: "whole number", float: "number", str: "text"}
    return names.get(annotation) or f"table with {KINDS[annotation.__name__]} keys"


def bounds(metadata: Sequence[Any], unit: str) -> str:
    """Bounds of a number, or of the length of a text or a list, of so many units."""
    words = length(metadata, unit)
    for each in flat(metadata):
        for side, sign in (("gt", "> "), ("ge", "at least "), ("lt", "< "), ("le", "at most ")):
            if abs(getattr(each, side, None) or 0) < LARGEST and hasattr(each, side):
                words.append(f"{sign}{float(getattr(each, side)):g}")
    return f", {', '.join(words)}" if words else ""


def length(metadata: Sequence[Any], unit: str) -> list[str]:
    """How long a text or a list may be, in words; nothing where any length will do."""
    found = {
        side: getattr(each, side)
        for each in flat(metadata)
        for side in ("min_length", "max_length")
        if getattr(each, side, None) is not None
    }
    least, most = found.get("min_length", 0), found.get("max_length")
    if most is None:
        return [f"{least} or more {unit}"] if least else []
    if least == most:
        return [f"{most} {unit}"]
    return [f"{least} to {most} {unit}" if least else f"at most {most} {unit}"]


def flat(metadata: Sequence[Any]) -> Iterator[Any]:
    """Bounds, those within a field's among them."""
    for each in metadata:
        yield each
        yield from getattr(each, "metadata", ())


def members(annotation: Any) -> Iterator[Any]:
    """The types that an annotation is made of."""
    yield annotation
    for each in get_args(annotation):
        if get_origin(annotation) is not Literal:
            yield from members(each)


def is_table(annotation: Any) -> bool:
    """Whether a type is a table with keys of its own."""
    if not isinstance(annotation, type) or get_origin(annotation) is not None:
        return False
    if annotation.__name__ in KINDS or in_python(annotation):
        return False
    return dataclasses.is_dataclass(annotation) or hasattr(annotation, "model_fields")


def in_python(annotation: Any) -> bool:
    """Whether only a script can give it."""
    return getattr(annotation, "__name__", "") in ONLY_IN_PYTHON


def listed(annotation: Any) -> bool:
    """Whether there may be several of a table: [[...]]."""
    return any(get_origin(each) in (tuple, list) for each in members(annotation))


def by_name(annotation: Any) -> bool:
    """Whether tables stand under names of one's own."""
    return any(get_origin(each) in (dict, Mapping) for each in members(annotation))


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown, TEMPLATE)
