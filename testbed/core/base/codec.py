"""JSON of frozen dataclasses by pydantic, following the types of the fields.

An array is nested lists. A value derived from a model, such as a minimal set, is written as a name,
from which a function passed by the reader makes it again. No content is executed or used as a file
name. pydantic is imported on first use.
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

ValueFactories = Mapping[type, Callable[[Any], Any]]
"""Functions that make a value from its name in JSON, by class."""


class ArraySchema:
    """Pydantic schema of a float array: nested lists in JSON, null for NaN."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        from pydantic_core import core_schema as schemas

        return schemas.no_info_plain_validator_function(
            _parse_array,
            json_schema_input_schema=schemas.list_schema(),
            serialization=schemas.plain_serializer_function_ser_schema(
                lambda array: array.tolist(), return_schema=schemas.list_schema()
            ),
        )


def _parse_array(value: Any) -> Any:
    """Float64 array of nested lists; null becomes NaN.

    Raises:
        ValueError: The value is no array of numbers.
    """
    try:
        return np.array(value, dtype=np.float64)
    # pydantic reports a ValueError as an invalid input
    except (
        TypeError,
        OverflowError,
    ):
        raise ValueError("it is no array of numbers") from None


class TableSchema:
    """Pydantic schema of a dataclass whose constructor checks its fields: a table in JSON."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> Any:
        from pydantic_core import core_schema as schemas

        return schemas.no_info_plain_validator_function(
            lambda value: value if isinstance(value, source) else source(**value),
            json_schema_input_schema=handler(source),
            serialization=schemas.plain_serializer_function_ser_schema(
                to_json_values, return_schema=schemas.any_schema()
            ),
        )


def schema_by_name(name: Callable[[Any], Any]) -> Any:
    """Method `__get_pydantic_core_schema__` of a class whose values are names in JSON.

    On reading, the entry of the class in `makers` of `from_json_values` makes the value of a name.

    Args:
        name: Function that returns the name of a value: a string, or a list of strings.
    """

    def schema(cls: type, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema as schemas

        def value_of_name(word: Any, info: ValidationInfo) -> Any:
            if isinstance(word, cls):
                return word
            if info.context is None:
                raise ValueError(f"it is no {cls.__name__}")
            return info.context[cls](word)

        return schemas.with_info_plain_validator_function(
            value_of_name,
            json_schema_input_schema=schemas.any_schema(),
            serialization=schemas.plain_serializer_function_ser_schema(
                name, return_schema=schemas.any_schema()
            ),
        )

    return classmethod(schema)


def schema_with_properties(*names: str) -> Any:
    """Method `__get_pydantic_core_schema__` that writes properties as well as fields to JSON.

    Args:
        *names: Names of properties: numbers, arrays, dataclasses or tuples of these.
    """

    def schema(cls: type, source: Any, handler: GetCoreSchemaHandler) -> Any:
        from pydantic_core import core_schema as schemas

        def fields_and_properties(
            value: Any, fields: Callable[[Any], Any]
        ) -> dict[str, Any]:
            return {
                **fields(value),
                **{name: _json_value(getattr(value, name)) for name in names},
            }

        core_schema: Any = handler(source)
        core_schema["serialization"] = schemas.wrap_serializer_function_ser_schema(
            fields_and_properties
        )
        return core_schema

    return classmethod(schema)


def _json_value(value: Any) -> Any:
    """JSON value of a property: a number, an array, a dataclass or a tuple."""
    if isinstance(value, tuple):
        return [_json_value(each) for each in value]
    if is_dataclass(value):
        return to_json_values(value)
    return value.tolist() if isinstance(value, np.ndarray) else value


@lru_cache
def type_adapter(kind: Any) -> TypeAdapter[Any]:
    """Pydantic adapter that writes, checks and describes values of a type; cached."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def to_json_values(value: Any, kind: Any = None, exclude: Any = None) -> Any:
    """Convert a value to JSON types; infinite numbers and NaN stay floats.

    Args:
        value: Value to write.
        kind: Type of the value; default its class.
        exclude: Fields to leave out, in pydantic's form.
    """
    return type_adapter(kind or value.__class__).dump_python(value, exclude=exclude)


def json_text(content: Any, *, exact: bool = False) -> bytes:
    """JSON text of plain values, floats with all digits.

    Args:
        content: Plain values, as returned by `to_json_values`.
        exact: True to keep NaN and Infinity, on one line, for this package only. Default null in
            their place, for other programs.
    """
    from pydantic_core import to_jsonable_python

    if exact:
        return json.dumps(content).encode()
    return json.dumps(
        to_jsonable_python(content, inf_nan_mode="null"), indent=1
    ).encode()


def parse_json(text: bytes) -> Any:
    """Parse JSON text.

    Raises:
        ValueError: The text is not JSON.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def from_json_values(kind: Any, content: Any, makers: ValueFactories) -> Any:
    """Make a value of a type from JSON values.

    Args:
        kind: Type of the value.
        content: Plain values.
        makers: Functions that make values from names, by class; for classes of `schema_by_name`.

    Raises:
        ValueError: The content does not fit the type.
    """
    return type_adapter(kind).validate_python(content, context=makers)
