"""Values stay as they were made: frozen, with arrays of one shape that nobody writes to."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.excitation.collision_model import Obstacle
from testbed.excitation.fourier import Fourier
from testbed.excitation.limit_terms import PlateRange
from testbed.excitation.limits import Limits
from testbed.excitation.stencil import Stencil
from testbed.experiment.matrix_errors import MatrixErrors
from testbed.identification.combined import Combined, Disagreement
from testbed.identification.consistency import Bent, Consistent
from testbed.identification.friction_curves import FrictionCurve
from testbed.identification.held_out import HeldOut
from testbed.identification.known_payload import KnownPayload
from testbed.identification.payload import PayloadEstimate
from testbed.identification.plate_doubt import PlateDoubt
from testbed.identification.rest import Pose
from testbed.identification.stated import Stated
from testbed.identification.validate import Validation
from testbed.parameters.prior import Prior
from testbed.robot.links import Link
from testbed.robot.visuals.shapes import Shape


def dataclasses_of_the_project() -> list[type[Any]]:
    found = []
    for module in pkgutil.walk_packages(tb.__path__, "testbed."):
        if not module.name.endswith("__main__"):
            inside = vars(importlib.import_module(module.name)).values()
            found += [
                each
                for each in inside
                if inspect.isclass(each)
                and each.__module__ == module.name
                and dataclasses.is_dataclass(each)
            ]
    return found


def arrays_of(kind: type[Any]) -> list[str]:
    return [each.name for each in dataclasses.fields(kind) if "Array" in str(each.type)]


CLASSES = dataclasses_of_the_project()
NOUNS = [each for each in CLASSES if not each.__name__.startswith("_")]
CHECKED = [each for each in NOUNS if "__post_init__" in vars(each) and arrays_of(each)]
"""Values that people make: their shapes are checked."""

rng = np.random.default_rng(0)


def some(*shape: int) -> np.ndarray:
    return rng.normal(size=shape)


NOTHING: Any = None  # where arrays alone matter

EXAMPLES: dict[str, Any] = {
    "Motion": lambda: tb.Motion(some(4), some(4, 2), some(4, 2), some(4, 2)),
    "Fourier": lambda: Fourier(0.1, some(2), some(2, 3), some(2, 3)),
    "Limits": lambda: Limits(*some(5, 2)),
    "Obstacle": lambda: Obstacle(some(3), some(3)),
    "PlateRange": lambda: PlateRange(np.ones(6), np.ones(2)),
    "Stencil": lambda: Stencil(some(4, 3, 2), some(6, 4)),
    "Inertia": lambda: tb.Inertia(1.0, some(3), some(3, 3)),
    "Joint": lambda: tb.Joint("a", "b", "revolute", -1, some(3), some(3), some(3, 3), some(2)),
    "Tree": lambda: tb.Tree("none", (), (), gravity=some(3)),
    "Shape": lambda: Shape(
        0, "mesh", some(3), some(3), some(3, 3), some(4), some(5, 3), some(6, 3)
    ),
    "Estimate": lambda: tb.Estimate(
        "external", ("a", "b"), ("kg", "kg"), some(2), some(2), some(2, 2), some(3), ("Fx",),
        ("N",), some(1), some(1), (5,), 1.0, NOTHING, (), (), NOTHING, None, ("a",),
        nuisance_covariance=some(3, 3), nuisance_cross=some(2, 3),
    ),
    "Prior": lambda: Prior(some(2, 10), some(2), some(2, 2, 3)),
    "Link": lambda: Link("a", 0, "a", some(3, 3), some(3), NOTHING),
    "Bent": lambda: Bent(
        "external", ("a", "b"), ("kg", "kg"), some(2), some(2), some(2), some(2, 2), 1.0, 1.0
    ),
    "Consistent": lambda: Consistent(
        ("a", "b"), ("a", "b"), ("c", "d"), some(2, 10), some(2, 10), some(2, 10), some(2, 10),
        (NOTHING,), some(1), some(1), (), some(2, 4), some(2), (), 0.0, 0.5, {}, (),
    ),
    "HeldOut": lambda: HeldOut(("a",), ("N m",), some(1), some(1), some(1)),
    "Validation": lambda: Validation(
        "external", ("Fx",), ("N",), (5,), some(1), some(1), some(1), some(1), some(1)
    ),
    "Stated": lambda: Stated(
        "external", ("a", "b"), some(2), some(2, 2), some(3), some(1), {}
    ),
    "FrictionCurve": lambda: FrictionCurve("a", some(3), some(3), some(3), 1.0, "N m"),
    "Combined": lambda: Combined(("a", "b"), some(2), some(2), some(3), some(3), NOTHING),
    "Disagreement": lambda: Disagreement(("a", "b"), some(2), 1.0),
    "PlateDoubt": lambda: PlateDoubt(("a", "b"), some(2, 3)),
    "MatrixErrors": lambda: MatrixErrors(some(6, 6), some(6, 6)),
    "KnownPayload": lambda: KnownPayload("a", some(10), some(10, 4), ()),
    "Pose": lambda: Pose(some(3), some(6), some(6), 0.5),
    "PayloadEstimate": lambda: PayloadEstimate(
        "a", (), (), (), some(10), some(10), some(10, 10), 10, 1.0
    ),
    "Recording": lambda: tb.Recording(
        ("a", "b"), np.arange(4.0), some(4, 2), some(4, 2), some(4, 6), some(4, 2), some(4, 2),
        some(6), some(4, 7),
    ),
}  # fmt: skip
FREE = {
    ("Shape", "size", 0),
    ("Shape", "vertices", 0),
    ("Shape", "faces", 0),
    ("Stated", "residual", 0),
    ("Pose", "position", 0),
    ("PlateDoubt", "root", 1),
}
"""Axes of any length that nothing else has."""


def test_every_checked_value_has_an_example() -> None:
    assert {each.__name__ for each in CHECKED} == set(EXAMPLES)


def test_values_are_frozen_and_those_with_arrays_are_themselves_alone() -> None:
    """Arrays have no one answer to `==`: what holds them is compared by identity."""
    assert [kind for kind in NOUNS if not kind.__dataclass_params__.frozen] == []
    assert [kind for kind in NOUNS if kind.__dataclass_params__.eq and arrays_of(kind)] == []


@pytest.mark.parametrize("name", EXAMPLES)
def test_arrays_of_values_refuse_to_be_written_to(name: str) -> None:
    value = EXAMPLES[name]()
    for field in arrays_of(type(value)):
        array = getattr(value, field)
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, field, array)


@pytest.mark.parametrize("name", EXAMPLES)
def test_values_do_not_change_with_what_they_were_made_of(name: str) -> None:
    value = EXAMPLES[name]()
    for field in arrays_of(type(value)):
        given = getattr(value, field).copy()
        made = dataclasses.replace(value, **{field: given})
        before = getattr(made, field).copy()
        given *= 2
        np.testing.assert_array_equal(getattr(made, field), before)


@pytest.mark.parametrize("name", EXAMPLES)
def test_arrays_of_another_shape_are_refused_by_name(name: str) -> None:
    """One entry more along any axis of any one array, or one axis more."""
    value = EXAMPLES[name]()
    for field in arrays_of(type(value)):
        array = getattr(value, field)
        longer = [
            np.concatenate([array, np.take(array, [-1], axis)], axis)
            for axis in range(array.ndim)
            if (name, field, axis) not in FREE
        ]
        for other in (*longer, array[None], array[..., None]):
            with pytest.raises(ValueError, match=r"\w+ has shape .*, expected \("):
                dataclasses.replace(value, **{field: other})
