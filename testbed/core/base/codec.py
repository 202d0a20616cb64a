"""Frozen dataclasses as JSON and back, by pydantic: fields are what their types say.

An array is nested lists. What is made from a model, as a minimal set, is a name in JSON, and who
reads it says what makes it again. Nothing in such a file is code, or becomes the name of a file.
pydantic is loaded when something is written or read.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, TypeAdapter, ValidationInfo
    from pydantic_core import CoreSchema

Makers = Mapping[type, Callable[[Any], Any]]
"""What makes values of their names, by class."""


class ArraySchema:
    """Of an array of floats, beside its type: nested lists in JSON; null is not a number."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        from pydantic_core import core_schema as schemas

        return schemas.no_info_plain_validator_function(
            _array,
            json_schema_input_schema=schemas.list_schema(),
            serialization=schemas.plain_serializer_function_ser_schema(
                lambda array: array.tolist(), return_schema=schemas.list_schema()
            ),
        )


def _array(value: Any) -> Any:
    try:
        return np.array(value, dtype=np.float64)
    # pydantic takes a ValueError for the input's fault
    except (
        TypeError,
        OverflowError,
    ):
        raise ValueError("it is no array of numbers") from None


class TableSchema:
    """Of a dataclass that checks its own fields, beside its type: a table in JSON."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> Any:
        from pydantic_core import core_schema as schemas

        return schemas.no_info_plain_validator_function(
            lambda value: value if isinstance(value, source) else source(**value),
            json_schema_input_schema=handler(source),
            serialization=schemas.plain_serializer_function_ser_schema(
                encode, return_schema=schemas.any_schema()
            ),
        )


def named(name: Callable[[Any], Any]) -> Any:
    """`__get_pydantic_core_schema__` of a class whose values are names in JSON.

    Args:
        name: Of a value; a string, or a list of some.
    """

    def schema(cls: type, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema as schemas

        def made(word: Any, info: ValidationInfo) -> Any:
            if isinstance(word, cls):
                return word
            if info.context is None:
                raise ValueError(f"it is no {cls.__name__}")
            return info.context[cls](word)

        return schemas.with_info_plain_validator_function(
            made,
            json_schema_input_schema=schemas.any_schema(),
            serialization=schemas.plain_serializer_function_ser_schema(
                name, return_schema=schemas.any_schema()
            ),
        )

    return classmethod(schema)


def with_properties(*names: str) -> Any:
    """`__get_pydantic_core_schema__` of a dataclass with properties beside its fields in JSON.

    Args:
        names: Of the properties: numbers, arrays, dataclasses or tuples of them.
    """

    def schema(cls: type, source: Any, handler: GetCoreSchemaHandler) -> Any:
        from pydantic_core import core_schema as schemas

        def with_them(value: Any, fields: Callable[[Any], Any]) -> dict[str, Any]:
            return {
                **fields(value),
                **{name: _plain(getattr(value, name)) for name in names},
            }

        found: Any = handler(source)
        found["serialization"] = schemas.wrap_serializer_function_ser_schema(with_them)
        return found

    return classmethod(schema)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    if is_dataclass(value):
        return encode(value)
    return value.tolist() if isinstance(value, np.ndarray) else value


@lru_cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """What writes, checks and describes values of a type; made once."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def encode(value: Any, kind: Any = None, exclude: Any = None) -> Any:
    """A value as JSON takes it, but for numbers that are infinite or none.

    Args:
        value: What is written.
        kind: Its type; default the value's class.
        exclude: Fields to leave out, as pydantic takes them.
    """
    return adapter(kind or value.__class__).dump_python(value, exclude=exclude)


def json_text(content: Any, *, exact: bool = False) -> bytes:
    """JSON of what `encode` gives, floats to the last digit.

    Args:
        content: Plain values.
        exact: For ourselves, in one line: NaN and Infinity stay what they are. Default for other
            programs, which know neither: null.
    """
    from pydantic_core import to_jsonable_python

    if exact:
        return json.dumps(content).encode()
    return json.dumps(
        to_jsonable_python(content, inf_nan_mode="null"), indent=1
    ).encode()


def from_json(text: bytes) -> Any:
    """Plain values of JSON.

    Raises:
        ValueError: It is none.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def decode(kind: Any, content: Any, makers: Makers) -> Any:
    """A value again.

    Args:
        kind: Its type.
        content: Plain values.
        makers: What makes values of names.

    Raises:
        ValueError: They are not of this type.
    """
    return adapter(kind).validate_python(content, context=makers)
