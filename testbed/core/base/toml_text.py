"""Reading and validation of TOML tables and of "table.key=value" settings."""

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
    missing_file_message,
    printable_line,
    shortened_list,
)
from testbed.core.base.file_kinds import kind_of, kind_of_tables, wrong_kind_message

MAX_FILE_BYTES = 1_000_000
"""Largest size of a TOML file [bytes]."""

MAX_QUOTED_LENGTH = 60
"""Largest number of characters of a value or --set setting that is quoted in a message."""

MAX_KEY_PARTS = 1000
"""Largest number of parts of a dotted key; the memory of the parser grows with its square."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


STRICT_TABLE = ConfigDict(
    extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
)
"""Pydantic configuration of a frozen table that rejects unknown keys."""

ModelT = TypeVar("ModelT", bound=BaseModel)

TOML_TERMS = {
    "Input should be": "should be",
    "an object": "a table, such as { name = 1 }",
    "a valid dictionary": "a table, such as { name = 1 }",
    "a valid array": "a list, such as [1, 2]",
    "a valid string": "text in quotes",
    "a valid boolean": "true or false",
    "a valid integer": "a whole number",
    "a valid number": "a number",
}
"""Replacements for pydantic's terms in messages about TOML files."""


def read_toml(path: Path, what: str = "experiment") -> dict[str, Any]:
    """Parse a TOML file and check its kind, but not its keys.

    Args:
        path: The file.
        what: Expected kind of the file; files of unrecognised kind are also accepted.

    Raises:
        ExperimentError: The file does not exist, is not TOML, is too large, or is of another kind.
    """
    if not path.is_file():
        raise ExperimentError(missing_file_message(path, f"{what} file"))
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError(f"it has more than {MAX_FILE_BYTES:.0e} bytes")
        text = path.read_text(encoding="utf-8")
        if any(
            line.partition("=")[0].count(".") > MAX_KEY_PARTS
            for line in text.splitlines()
        ):
            raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts")
        content = tomllib.loads(text)
        kind = kind_of_tables(content)
    except RecursionError:
        raise ExperimentError(
            f"{path}: not a readable TOML file: nested too deeply"
        ) from None
    except (OSError, ValueError) as error:
        if not (kind := kind_of(path)):
            raise ExperimentError(
                f"{path}: not a readable TOML file: {_parser_message(error)}"
            ) from None
        content = {}
    if kind not in ("", what):
        raise ExperimentError(wrong_kind_message(path, kind, what))
    return content


def apply_settings(content: dict[str, Any], settings: Iterable[str]) -> None:
    """Set keys of tables from settings "table.key=value".

    Args:
        content: Tables, changed in place; missing tables are added.
        settings: Settings; their values are in TOML syntax, or are text without quotes.

    Raises:
        ExperimentError: A setting is not of the form "table.key=value", or its key refers to a
            value as if it were a table.
    """
    for setting in settings:
        key, equals, value = setting.partition("=")
        setting = printable_line(setting, MAX_QUOTED_LENGTH)
        if not equals or not key.strip():
            raise ExperimentError(f"--set '{setting}': write it as table.key=value")
        *tables, last = _key_parts(key.strip(), setting)
        table_content = content
        for table in tables:
            table_content = table_content.setdefault(table, {})
            if not isinstance(table_content, dict):
                raise ExperimentError(
                    f"--set '{setting}': '{table}' is a value, not a table"
                )
        table_content[last] = _parse_value(value, setting)


def _key_parts(key: str, setting: str) -> list[str]:
    """Parts of a dotted key, without the quotes around parts that contain dots.

    Raises:
        ExperimentError: The key is not valid TOML.
    """
    if '"' not in key and "'" not in key:
        return key.split(".")
    try:
        content: Any = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        raise ExperimentError(f"--set '{setting}': '{key}' is no key of TOML") from None
    names = []
    while isinstance(content, dict):
        name, content = next(iter(content.items()))
        names.append(name)
    return names


def _parse_value(text: str, setting: str) -> Any:
    """Parse a value in TOML syntax; return other text unchanged.

    Raises:
        ExperimentError: The value contains a number with thousands of digits, or is nested too
            deeply.
    """
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    except (ValueError, RecursionError) as error:
        raise ExperimentError(f"--set '{setting}': {_parser_message(error)}") from None


def _parser_message(error: Exception) -> str:
    """Message of an error of the TOML parser, reworded for users."""
    if isinstance(error, UnicodeDecodeError):
        return "it is no text"
    is_long_integer = type(error) is ValueError and "integer string conversion" in str(
        error
    )
    return "a number has thousands of digits" if is_long_integer else str(error)


def validate_tables(
    model: type[ModelT], content: dict[str, Any], source: str
) -> ModelT:
    """Validate tables and return an instance of their pydantic model.

    Args:
        model: Pydantic model of the tables.
        content: Tables as parsed from TOML.
        source: Name of the source in messages.

    Raises:
        ExperimentError: The tables do not fit the model; the message lists the errors on one line
            (`validation_message`).
    """
    try:
        return model.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        raise ExperimentError(f"{source}: {validation_message(error, model)}") from None
    except (RecursionError, ValueError):
        raise ExperimentError(
            f"{source}: it is nested too deeply, or no text"
        ) from None


def validation_message(error: ValidationError, model: type[BaseModel]) -> str:
    """Message that lists the first validation errors, with suggestions for unknown keys.

    The first unknown key precedes all other errors. If the message exceeds 270 characters, only the
    number of the remaining errors is given.

    Args:
        error: Errors of pydantic.
        model: Pydantic model of the tables.
    """
    unknown, lines = [], []  # a misspelt key is missing, too: its message comes first
    for fault in error.errors(include_url=False):
        path = [str(part) for part in fault["loc"]]
        if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            *tables, key = path
            unknown.append(_unknown_key_message(model, tables, key))
        else:
            message = fault["msg"].removeprefix("Value error, ")
            for pydantic_term, toml_term in TOML_TERMS.items():
                message = message.replace(pydantic_term, toml_term)
            value = repr(fault["input"])
            value = (
                value
                if len(value) <= MAX_QUOTED_LENGTH
                else f"{value[:MAX_QUOTED_LENGTH]}..."
            )
            found_value = (
                ""
                if fault["type"] in ("missing", "value_error")
                else f", found {value}"
            )
            label = ".".join(part for part in path if "[" not in part)
            lines.append(f"{label}: {message}{found_value}" if label else message)
    # 270: characters of all errors in one message
    return shortened_list(
        list(dict.fromkeys([*unknown[:1], *lines, *unknown])), 270, "; "
    )


def _unknown_key_message(model: type[BaseModel], tables: list[str], key: str) -> str:
    """Message about an unknown key, with suggestions.

    For a key outside all tables, the message lists the tables that have this key; otherwise, it
    suggests similar keys of the same table.

    Args:
        model: Pydantic model of the file.
        tables: Names of the enclosing tables.
        key: The unknown key.
    """
    owners = (
        []
        if tables
        else [t for t in model.model_fields if key in _known_keys(model, [t])]
    )
    if owners:
        return f"unknown key '{key}'; did you mean {' or '.join(f'{t}.{key}' for t in owners)}?"
    place = f" in [{'.'.join(tables)}]" if tables else ""
    return str(UnknownName(f"key{place}", key, _known_keys(model, tables)))


def _known_keys(model: Any, tables: list[str]) -> tuple[str, ...]:
    """Known keys of a nested table; empty if its type is not a table.

    Args:
        model: Pydantic model of the file.
        tables: Names of the enclosing tables, outermost first.
    """
    for table in tables:
        known = getattr(model, "model_fields", {})
        model = (
            _without_none(known[table].annotation)
            if table in known
            else _value_type(model)
        )
    if isinstance(model, type) and issubclass(model, BaseModel):
        return tuple(model.model_fields)
    return tuple(f.name for f in fields(model)) if is_dataclass(model) else ()


def _without_none(annotation: Any) -> Any:
    """Type of an optional table, such as WrenchTable for WrenchTable | None."""
    arguments = getattr(annotation, "__args__", ())
    types = [each for each in arguments if each is not type(None)]
    return types[0] if len(types) < len(arguments) else annotation


def _value_type(annotation: Any) -> Any:
    """Type of the values of a mapping, such as Bound for dict[str, Bound]."""
    arguments = getattr(annotation, "__args__", ())
    return arguments[-1] if arguments else None
