"""Errors carry what they are about, and say what to do."""

from __future__ import annotations

import inspect

import pytest

from testbed import errors
from testbed.errors import FreeRootError, InertiaError, UnknownName, UnseenParameters

KINDS = [
    each for each in vars(errors).values() if inspect.isclass(each) and issubclass(each, Exception)
]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_is_one_of_the_projects(kind: type[Exception]) -> None:
    assert issubclass(kind, errors.TestbedError)
    assert kind.__doc__


def test_flaws_are_kept_and_listed() -> None:
    error = InertiaError("arm.urdf", ["link 'a' is wrong", "link 'b' is wrong"])
    assert error.flaws == ("link 'a' is wrong", "link 'b' is wrong")
    assert "arm.urdf: link 'a' is wrong; link 'b' is wrong. " in str(error)
    assert "--accept-inertia" in str(error)


def test_a_free_root_is_named_with_the_way_out() -> None:
    error = FreeRootError("humanoid.xml", "root")
    assert error.joint == "root"
    assert "humanoid.xml" in str(error)
    assert "'root'" in str(error)
    assert "--weld-root" in str(error)


def test_a_name_nearly_known_is_proposed_and_a_strange_one_is_not() -> None:
    near = UnknownName("joint", "elbw", iter(["waist", "elbow"]))
    assert (near.name, near.known) == ("elbw", ("waist", "elbow"))
    assert str(near) == "unknown joint 'elbw'; did you mean 'elbow'? (known: waist, elbow)"
    assert str(UnknownName("joint", "xyz", ["waist"])) == "unknown joint 'xyz' (known: waist)"


def test_unseen_parameters_are_counted_and_named() -> None:
    error = UnseenParameters(["K1zz", "mb2x"], 5, 7, 100)
    assert error.names == ("K1zz", "mb2x")
    assert error.rank == 5
    assert "100 samples determine only 5 of 7 unknowns" in str(error)
    assert "K1zz, mb2x" in str(error)
