"""What every table and value of the program is where nobody says anything, as approved."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import testbed
from tests.helpers.approved import hold

pytestmark = pytest.mark.slow

NONE = (dataclasses.MISSING, PydanticUndefined)


def modules() -> Iterator[ModuleType]:
    """All but the one that is a command when it is imported."""
    for found in pkgutil.walk_packages(testbed.__path__, "testbed."):
        if not found.name.endswith("__main__"):
            yield importlib.import_module(found.name)


def classes() -> Iterator[tuple[str, type[Any]]]:
    """Every class of the program by its full name."""
    for module in modules():
        for name, each in sorted(vars(module).items()):
            if inspect.isclass(each) and each.__module__ == module.__name__:
                yield f"{module.__name__}.{name}", each


def defaults(each: type[Any]) -> Iterator[tuple[str, Any]]:
    """What a class says of fields that are not given."""
    if issubclass(each, BaseModel):
        for name, field in each.model_fields.items():
            yield name, field.get_default(call_default_factory=True)
    elif dataclasses.is_dataclass(each):
        for part in dataclasses.fields(each):
            made: Any = part.default_factory
            yield part.name, part.default if made is dataclasses.MISSING else made()


def test_defaults_are_as_approved() -> None:
    lines = [
        f"{place}.{name} = {value!r}"
        for place, each in classes()
        for name, value in defaults(each)
        if not any(value is none for none in NONE)
    ]
    assert len(lines) > 300
    hold("defaults.txt", "\n".join(line.replace("\n", " ") for line in lines) + "\n")


def test_tables_of_files_are_frozen() -> None:
    """What a file says is a value."""
    for place, each in classes():
        if issubclass(each, BaseModel):
            assert each.model_config.get("frozen"), place
