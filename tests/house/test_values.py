"""Values stay as they were made: arrays of one shape, that nobody writes to."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.helpers.measured import random_fourier
from tests.helpers.refusals import is_message
from tests.helpers.runs import robot
from tests.scenarios.scenarios import result

pytestmark = pytest.mark.slow


def values(found: Any) -> Iterator[Any]:
    """A value of the project and all that it is made of."""
    if isinstance(found, dict):
        found = tuple(found.values())
    if isinstance(found, list | tuple):
        for each in found:
            yield from values(each)
    elif dataclasses.is_dataclass(found):
        yield found
        for field in dataclasses.fields(found):
            yield from values(getattr(found, field.name))


def arrays(value: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of a value, by field."""
    fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return {name: each for name, each in fields.items() if isinstance(each, np.ndarray)}


def test_arrays_of_values_are_of_one_shape_and_nobody_writes_to_them() -> None:
    """Else who holds a robot, a recording or an estimate could change it under all others."""
    motion = random_fourier(robot("puma"), np.random.default_rng(0), 1.0)
    made = [result(name) for name in ("puma", "gantry", "payload", "plate", "bodies")]
    found = [*values(made), motion, motion.at(np.arange(9.0))]
    checked = {type(each): each for each in found if hasattr(each, "__post_init__")}
    assert {"Recording", "Estimate", "Tree", "Fourier"} <= {kind.__name__ for kind in checked}
    for kind, value in checked.items():
        for name, array in arrays(value).items():
            assert not array.flags.writeable, (kind, name)
            given = array.copy()
            same = dataclasses.replace(value, **{name: given})
            given += 1
            np.testing.assert_array_equal(getattr(same, name), array)
            wide = np.eye(array.ndim, dtype=int)
            longer = [np.pad(array, [(0, k) for k in one], "edge") for one in wide if array.size]
            for other in (array[None], *longer):
                with pytest.raises(ValueError) as refusal:  # noqa: PT011
                    dataclasses.replace(value, **{name: other})
                assert is_message(str(refusal.value)), (kind, name)
