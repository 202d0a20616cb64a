"""What Python is promised, from the docstrings: `python -m docs.api`.

The page shows what a group of functions computes, as a formula; what each takes and returns is
written between its marks from the function itself.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from docs.marks import mark_of, prose, table, write

DOCUMENT = Path(__file__).with_suffix(".md")
TEMPLATE = DOCUMENT.parent / "templates" / DOCUMENT.name
MODULE = "docs.api"
REST = "all else"
"""The place of what stands in no other."""
SECTIONS = re.compile(r"^(Args|Returns|Raises|Attributes|Yields):$", re.MULTILINE)
HEADS = {
    "Args": "argument | type | meaning",
    "Attributes": "attribute | type | meaning",
    "Raises": "error | when",
}
ENTRY = re.compile(r"^    ([\w, *]+): ((?:.|\n(?: {8}|\n))*)", re.MULTILINE)


def as_markdown(of: str) -> str:
    """The entries of one place.

    Args:
        of: Names with blanks between them, or REST.
    """
    import testbed as tb

    names = of.split()
    if of == REST:
        names = [n for n in tb.__all__ if n not in placed() and not n.startswith("_")]
    lines: list[str] = []
    for name in names:
        lines += ["", f"### {name}", "", *entry(name, getattr(tb, name))]
    return "\n".join([*lines, "", ""])


def placed() -> set[str]:
    """Names that have a place."""
    mark = re.escape(mark_of(MODULE, "NAMES")).replace("NAMES", "(.*)")
    return {name for names in re.findall(mark, TEMPLATE.read_text()) for name in names.split()}


def entry(name: str, thing: Any) -> list[str]:
    """What there is to say of a function or class.

    Args:
        name: How it is called.
        thing: It.
    """
    lines = [f"**`{signature(f'tb.{name}', thing)}`**", "", *described(thing)]
    if inspect.isclass(thing):
        lines += members(thing)
    return lines


def signature(name: str, thing: Any) -> str:
    """How something is called: its arguments, with defaults that are plain values."""
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return name
    found = inspect.signature(thing)
    kept = [
        each.replace(annotation=inspect.Parameter.empty, default=Shown.of(each.default))
        for each in found.parameters.values()
        if each.name != "self" and not each.name.startswith("_")
    ]
    words = str(found.replace(parameters=kept, return_annotation=inspect.Signature.empty))
    back = "" if inspect.isclass(thing) else types(thing).get("return", "")
    return f"{name}{words}{f' -> {back}' if back else ''}"


class Shown:
    """A default as the page shows it."""

    def __init__(self, words: str) -> None:
        self.words = words

    def __repr__(self) -> str:
        return self.words

    @staticmethod
    def of(default: Any) -> Any:
        """A default; what is no plain value is left out."""
        plain = default is None or isinstance(default, bool | int | float | str)
        if default is inspect.Parameter.empty or plain:
            return default
        return Shown(repr(default) if default in ((), ("joint-forces",)) else "...")


def types(thing: Any) -> dict[str, str]:
    """Types of arguments or fields by name, as the source writes them."""
    found = thing.__annotations__ if hasattr(thing, "__annotations__") else {}
    if inspect.isclass(thing):
        found = {k: v for kind in reversed(thing.__mro__) for k, v in types_of(kind).items()}
    texts = {
        k: v if isinstance(v, str) else getattr(v, "__name__", str(v)) for k, v in found.items()
    }
    return {k: re.sub(r"\b(?:[a-z_]+\.)+(\w+)", r"\1", v) for k, v in texts.items()}


def types_of(kind: type) -> dict[str, Any]:
    """Types of the fields that a class itself adds."""
    found: dict[str, Any] = vars(kind).get("__annotations__", {})
    return found


def described(thing: Any) -> list[str]:
    """A docstring as Markdown: its words, then tables."""
    before, *rest = SECTIONS.split(inspect.getdoc(thing) or "")
    lines = [prose(before.strip())]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        known = types(thing)
        found = [
            (f"`{k}`", *([typed(known.get(k))] * (title != "Raises")), prose(" ".join(v.split())))
            for k, v in ENTRY.findall(body)
        ]
        if title in ("Returns", "Yields") or not found:
            lines += ["", f"{title}: {prose(' '.join(body.split()))}"]
        else:
            lines += ["", *table(HEADS[title], found)]
    return lines


def typed(words: str | None) -> str:
    """A type in a cell."""
    return f"`{words}`" if words else ""


def members(kind: type) -> list[str]:
    """Properties and methods of a class, a row each."""
    rows = [
        (f"`{signature(name, member) if callable(member) else name}`", prose(summary(member)))
        for name, member in own(kind)
    ]
    return ["", *table("property or method | meaning", rows)] if rows else []


def own(kind: type) -> Iterator[tuple[str, Any]]:
    """What a class of the project offers, in the order in which it is written."""
    seen = set()
    for each in kind.__mro__:
        if each.__module__.startswith("testbed"):
            for name, member in vars(each).items():
                known = isinstance(member, property | cached_property | staticmethod | classmethod)
                if name.startswith("_") or name in seen or not (known or inspect.isroutine(member)):
                    continue
                seen.add(name)
                yield name, getattr(kind, name) if not hasattr(member, "fget") else member


def summary(member: Any) -> str:
    """The first words of a docstring."""
    return " ".join((inspect.getdoc(member) or "").split("\n\n")[0].split())


if __name__ == "__main__":
    write(DOCUMENT, MODULE, as_markdown, TEMPLATE)
