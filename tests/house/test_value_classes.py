"""Of every class of values, as its source says it: frozen, and alone equal to itself with arrays.

tests/house/test_values.py holds values themselves to it; this sees those that have no example.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.helpers.paths import ROOT

ARRAYS = ("Array", "Mask", "Index")
"""Names of array types in annotations."""

AT_WORK = {"_Desk", "_Reader"}
"""What changes while its one function works."""


def value_classes() -> Iterator[tuple[str, ast.ClassDef, dict[str, object]]]:
    """Place, class and arguments of its decorator."""
    for path in sorted((ROOT / "testbed").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ClassDef):
                continue
            for each in node.decorator_list:
                if isinstance(each, ast.Name) and each.id == "dataclass":
                    yield f"{path.name}: {node.name}", node, {}
                if isinstance(each, ast.Call) and ast.unparse(each.func) == "dataclass":
                    said = {word.arg or "": ast.literal_eval(word.value) for word in each.keywords}
                    yield f"{path.name}: {node.name}", node, said


def holds_arrays(node: ast.ClassDef) -> bool:
    """Whether a field is an array, or holds some."""
    fields = (each for each in node.body if isinstance(each, ast.AnnAssign))
    return any(
        isinstance(name, ast.Name) and name.id in ARRAYS
        for field in fields
        for name in ast.walk(field.annotation)
    )


def test_all_are_frozen() -> None:
    for place, _, said in value_classes():
        name = place.partition(": ")[2]
        assert said.get("frozen") is True or name in AT_WORK, place


def test_those_with_arrays_are_equal_to_themselves_alone() -> None:
    """Arrays compare element by element, so that the question has no one answer."""
    for place, node, said in value_classes():
        if holds_arrays(node):
            assert said.get("eq") is False, place
