"""What is known better than the model file knows it: gravity, limits, friction, rotors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ModelError, UnknownName
from testbed.robot.model_file import ModelFile
from testbed.robot.tree import SETTABLE
from testbed.simulation.build import build_plant
from tests.helpers.robots import random_robot

VALUES: dict[str, Any] = {
    "position_range": [-0.5, 1.5],
    "max_velocity": 0.2,
    "max_effort": 30,
    "coulomb": 0.7,
    "viscous": 0.0,
    "rotor_inertia": 1e-3,
}


def test_everything_settable_is_set_and_nothing_else(puma: tb.Tree) -> None:
    assert set(VALUES) == set(SETTABLE)
    for name, value in VALUES.items():
        changed = puma.with_joints({"elbow": {name: value}})
        for old, new in zip(puma.joints, changed.joints, strict=True):
            for key, before in vars(old).items():
                expected = value if (new.name, key) == ("elbow", name) else before
                assert np.array_equal(getattr(new, key), expected), key
        assert changed.inertias is puma.inertias
        np.testing.assert_array_equal(changed.gravity, puma.gravity)


def test_several_joints_are_set_at_once() -> None:
    tree = random_robot(np.random.default_rng(1), 6).tree()
    settings = {name: {"coulomb": float(k)} for k, name in enumerate(tree.names)}
    assert [joint.coulomb for joint in tree.with_joints(settings).joints] == list(range(6))
    assert all(joint.coulomb == 0 for joint in tree.joints)


def test_what_is_not_there_is_said_with_what_is(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="did you mean 'elbow'"):
        puma.with_joints({"elbo": {}})
    with pytest.raises(UnknownName, match="joint 'elbow' 'max_speed'.*max_velocity"):
        puma.with_joints({"elbow": {"max_speed": 1.0}})
    with pytest.raises(UnknownName):
        puma.with_joints({"elbow": {"offset": [0, 0, 0]}})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("position_range", [1.0, -1.0]),
        ("position_range", [0.0]),
        ("position_range", 3.0),
        ("position_range", ["a", 1]),
        ("position_range", [0, [1]]),
        ("max_velocity", 0.0),
        ("max_velocity", float("nan")),
        ("max_effort", -1.0),
        ("max_effort", 10**400),
        ("coulomb", -0.1),
        ("coulomb", float("inf")),
        ("viscous", "much"),
        ("viscous", True),
        ("rotor_inertia", None),
        ("rotor_inertia", {"a": 1}),
    ],
)
def test_what_no_joint_can_have_is_refused(puma: tb.Tree, name: str, value: object) -> None:
    with pytest.raises(ModelError, match="'elbow'") as caught:
        puma.with_joints({"elbow": {name: value}})
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


UNLIMITED = {
    "no limit": ("revolute", ""),
    "nothing known": ("revolute", '<limit lower="0" upper="0" effort="0" velocity="0"/>'),
    "some known": ("revolute", '<limit effort="0"/>'),
    "continuous": ("continuous", ""),
    "prismatic": ("prismatic", ""),
}


@pytest.mark.parametrize("what", UNLIMITED)
def test_joints_without_limits_are_read_and_can_be_given_them(what: str, tmp_path: Path) -> None:
    kind, limit = UNLIMITED[what]
    path = tmp_path / "r.urdf"
    text = random_robot(np.random.default_rng(5), 3).urdf()
    start = text.index('type="', text.index('<joint name="j2"'))
    end = text.index('"', start + 6)
    text = f'{text[:start]}type="{kind}{text[end:]}'
    start = text.index("<limit", text.index('<joint name="j2"'))
    end = text.index("/>", start) + 2
    path.write_text(text[:start] + limit + text[end:])
    tree = tb.load_tree(path)
    joint = tree.joints[tree.index("j2")]
    assert np.isinf(joint.position_range).all()
    assert np.isinf([joint.max_velocity, joint.max_effort]).all()
    build_plant(ModelFile(path), tree, 1e-3)
    given = tree.with_joints({"j2": {"position_range": [-1, 2], "max_effort": 7.0}})
    assert given.joints[tree.index("j2")].max_effort == 7.0


def test_gravity_is_replaced_and_checked(puma: tb.Tree) -> None:
    moon = puma.with_gravity([0, 0, -1.62])
    np.testing.assert_array_equal(moon.gravity, [0, 0, -1.62])
    assert moon.joints is puma.joints
    np.testing.assert_array_equal(puma.with_gravity(None).gravity, puma.gravity)
    assert not puma.with_gravity((0, 0, 0)).gravity.any()


def test_gravity_points_down_where_nothing_is_said() -> None:
    tree = random_robot(np.random.default_rng(1), 2).tree()
    bare = tb.Tree("bare", tree.joints, tree.inertias)
    np.testing.assert_array_equal(bare.gravity, [0.0, 0.0, -9.81])


@pytest.mark.parametrize(
    "gravity",
    [
        [0, 0],
        [0, 0, float("nan")],
        [0, 0, float("inf")],
        [0, 0, 10**400],
        [0, 0, 1e300],
        [0, 0, 1e-300],
        [0, 0, "9.81"],
        "down",
        [[0, 0, 9]],
        [0, 0, None],
        [[1], 2, 3],
        {},
        -9.81,
    ],
)
def test_what_is_no_gravity_is_refused(puma: tb.Tree, gravity: Any) -> None:
    with pytest.raises(ModelError, match="gravity") as caught:
        puma.with_gravity(gravity)
    assert "\n" not in str(caught.value)
