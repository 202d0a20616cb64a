"""TOML and "table.key=value" into tables; whatever is not understood becomes one clear line."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from testbed.core.base.errors import (
    ExperimentError,
    UnknownName,
    few,
    no_file,
    printable,
)
from testbed.core.base.file_kinds import kind_of, kind_of_tables, misplaced

LARGEST_FILE = 1_000_000
"""Bytes of a TOML file."""

LONGEST_SHOWN = 60
"""Characters of a value, or of a word of --set, in a message."""

LONGEST_KEY = 1000
"""Parts of a dotted key: the parser's memory grows with their square."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


KNOWN_KEYS = ConfigDict(
    extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
)
"""Of a table whose keys are all known."""

Checked = TypeVar("Checked", bound=BaseModel)

IN_TOML = {
    "Input should be": "should be",
    "an object": "a table, such as { name = 1 }",
    "a valid dictionary": "a table, such as { name = 1 }",
    "a valid array": "a list, such as [1, 2]",
    "a valid string": "text in quotes",
    "a valid boolean": "true or false",
    "a valid integer": "a whole number",
    "a valid number": "a number",
}
"""Pydantic's words, and plainer ones."""


def read_toml(path: Path, what: str = "experiment") -> dict[str, Any]:
    """The tables of a TOML file, unchecked.

    Args:
        path: The file.
        what: Kind of the file.

    Raises:
        ExperimentError: There is no such file, or it is not TOML, or of another kind.
    """
    if not path.is_file():
        raise ExperimentError(no_file(path, f"{what} file"))
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ValueError(f"it has more than {LARGEST_FILE:.0e} bytes")
        text = path.read_text(encoding="utf-8")
        if any(
            line.partition("=")[0].count(".") > LONGEST_KEY
            for line in text.splitlines()
        ):
            raise ValueError(f"a key has more than {LONGEST_KEY} parts")
        content = tomllib.loads(text)
        kind = kind_of_tables(content)
    except RecursionError:
        raise ExperimentError(
            f"{path}: not a readable TOML file: nested too deeply"
        ) from None
    except (OSError, ValueError) as error:
        if not (kind := kind_of(path)):
            raise ExperimentError(
                f"{path}: not a readable TOML file: {_of_parser(error)}"
            ) from None
        content = {}
    if kind not in ("", what):
        raise ExperimentError(misplaced(path, kind, what))
    return content


def override(content: dict[str, Any], settings: Iterable[str]) -> None:
    """Apply "table.key=value" words, the value in TOML or a bare word.

    Raises:
        ExperimentError: A word is not of that form.
    """
    for setting in settings:
        key, equals, value = setting.partition("=")
        setting = printable(setting, LONGEST_SHOWN)
        if not equals or not key.strip():
            raise ExperimentError(f"--set '{setting}': write it as table.key=value")
        *tables, last = _parts(key.strip(), setting)
        here = content
        for table in tables:
            here = here.setdefault(table, {})
            if not isinstance(here, dict):
                raise ExperimentError(
                    f"--set '{setting}': '{table}' is a value, not a table"
                )
        here[last] = _value(value, setting)


def _parts(key: str, setting: str) -> list[str]:
    """The names of a dotted key; a name with dots of its own stands in quotes.

    Raises:
        ExperimentError: It is no key.
    """
    if '"' not in key and "'" not in key:
        return key.split(".")
    try:
        found: Any = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        raise ExperimentError(f"--set '{setting}': '{key}' is no key of TOML") from None
    names = []
    while isinstance(found, dict):
        name, found = next(iter(found.items()))
        names.append(name)
    return names


def _value(text: str, setting: str) -> Any:
    """A value in TOML, or a bare word."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    except (ValueError, RecursionError) as error:
        raise ExperimentError(f"--set '{setting}': {_of_parser(error)}") from None


def _of_parser(error: Exception) -> str:
    """What the parser found, but for advice to programmers."""
    if isinstance(error, UnicodeDecodeError):
        return "it is no text"
    long = type(error) is ValueError and "integer string conversion" in str(error)
    return "a number has thousands of digits" if long else str(error)


def checked(model: type[Checked], content: dict[str, Any], source: str) -> Checked:
    """Tables as a frozen value.

    Args:
        model: What they should be.
        content: As TOML gives them.
        source: What they are called.

    Raises:
        ExperimentError: Says all that is wrong, in one line.
    """
    try:
        return model.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise ExperimentError(f"{source}: {complaints(error, model)}") from None
    except (RecursionError, ValueError):
        raise ExperimentError(
            f"{source}: it is nested too deeply, or no text"
        ) from None


def complaints(error: ValidationError, model: type[BaseModel]) -> str:
    """The first faults in one line, unknown keys with those that may be meant."""
    unknown, lines = [], []  # a key that is misspelt is missing, too: the first leads
    for fault in error.errors(include_url=False):
        where = [str(part) for part in fault["loc"]]
        if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            *tables, key = where
            unknown.append(_unknown(model, tables, key))
        else:
            said = fault["msg"].removeprefix("Value error, ")
            for json_words, toml_words in IN_TOML.items():
                said = said.replace(json_words, toml_words)
            value = repr(fault["input"])
            value = (
                value if len(value) <= LONGEST_SHOWN else f"{value[:LONGEST_SHOWN]}..."
            )
            found = (
                ""
                if fault["type"] in ("missing", "value_error")
                else f", found {value}"
            )
            label = ".".join(part for part in where if "[" not in part)
            lines.append(f"{label}: {said}{found}" if label else said)
    # characters for faults of a file in one message
    return few(list(dict.fromkeys([*unknown[:1], *lines, *unknown])), 270, "; ")


def _unknown(model: type[BaseModel], tables: list[str], key: str) -> str:
    """An unknown key, with the table that has one of this name, else with the known ones."""
    homes = (
        [] if tables else [t for t in model.model_fields if key in _keys(model, [t])]
    )
    if homes:
        return f"unknown key '{key}'; did you mean {' or '.join(f'{t}.{key}' for t in homes)}?"
    place = f" in [{'.'.join(tables)}]" if tables else ""
    return str(UnknownName(f"key{place}", key, _keys(model, tables)))


def _keys(model: Any, tables: list[str]) -> tuple[str, ...]:
    """The keys that a table knows."""
    for table in tables:
        known = getattr(model, "model_fields", {})
        model = _if_given(known[table].annotation) if table in known else _member(model)
    if isinstance(model, type) and issubclass(model, BaseModel):
        return tuple(model.model_fields)
    return tuple(f.name for f in fields(model)) if is_dataclass(model) else ()


def _if_given(annotation: Any) -> Any:
    """Of a table that may be left out, what it is: WrenchTable | None -> WrenchTable."""
    arguments = getattr(annotation, "__args__", ())
    given = [each for each in arguments if each is not type(None)]
    return given[0] if len(given) < len(arguments) else annotation


def _member(annotation: Any) -> Any:
    """What a table by name holds: dict[str, Bound] -> Bound."""
    arguments = getattr(annotation, "__args__", ())
    return arguments[-1] if arguments else None
