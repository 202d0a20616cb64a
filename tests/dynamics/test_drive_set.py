"""What rubs and turns at joints, and at shafts that turn with several: nothing is told twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.dynamics.drive_set import drive_set
from testbed.dynamics.witnesses import verify_drives
from testbed.errors import ModelError, UnknownName
from testbed.identification.predict import own_torque
from testbed.robot.shafts import with_shafts
from testbed.robot.tree import Joint, Kind
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import few, rngs

X, Y, Z = np.eye(3)
WRIST = {"motor": {"j1": 1.0, "j2": 1.0}}
DIFFERENTIAL = {"left": {"j1": 0.5, "j2": 0.5}, "right": {"j1": 0.5, "j2": -0.5}}


def chain(*axes: np.ndarray, last: Kind = "revolute") -> tb.Tree:
    """Joints about axes, each a step aside of the one before, with general bodies."""
    joints = []
    for k, axis in enumerate(axes):
        kind: Kind = last if k == len(axes) - 1 else "revolute"
        at = np.full(3, 0.3 * (k > 0))
        joints.append(Joint(f"j{k + 1}", f"b{k + 1}", kind, k - 1, axis, at, np.eye(3)))
    body = tb.Inertia.about_centre(2.0, [0.1, -0.2, 0.05], np.diag([0.1, 0.2, 0.15]))
    return tb.Tree("chain", tuple(joints), (body,) * len(axes))


def names(tree: tb.Tree, *terms: str) -> tuple[str, ...]:
    found = drive_set(tree, tb.minimal_set(tree, "dynamic"), terms)
    assert verify_drives(tree, found).holds
    return found.names


def test_only_what_the_structure_can_tell_has_a_column() -> None:
    """By hand: what a shaft of two joints adds to theirs."""
    wrist = with_shafts(chain(Z, Y), WRIST)
    own = {"coulomb/motor", "viscous/motor", "rotor/motor"}
    assert own <= set(names(wrist, "coulomb", "viscous", "rotor"))
    assert "offset/motor" not in names(wrist, "offset")  # the joints have theirs
    parallel = with_shafts(chain(Z, Z), WRIST)  # q1 + q2 is how the second body turns
    assert "K2zz+rotor/motor" in names(parallel, "rotor/motor")
    both = with_shafts(chain(Z, Y), DIFFERENTIAL)  # (a + b)^2 + (a - b)^2 = 2 a^2 + 2 b^2
    assert sum(name.startswith("viscous") for name in names(both, "viscous")) == 3
    assert sum(name.startswith("coulomb") for name in names(both, "coulomb")) == 4


def test_terms_of_single_joints_are_asked_for_by_name() -> None:
    tree = chain(Z, Z, Y)
    found = names(tree, "coulomb", "rotor/j2", "offset/j3")
    assert found[-5:] == ("coulomb/j1", "coulomb/j2", "coulomb/j3", "rotor/j2", "offset/j3")
    with refuses(UnknownName, "j4"):
        names(tree, "rotor/j4")
    with refuses(UnknownName, "glue"):
        tb.Settings(terms=("glue/j1",))


@few(10)
@given(rngs)
def test_what_a_shaft_takes_is_found_and_foretold(rng: np.random.Generator) -> None:
    """Dry and viscous friction and inertia act on the joints by the shaft's power."""
    tree = random_robot(rng, int(rng.integers(2, 7))).tree()
    while sum(joint.revolute for joint in tree.joints) < 2:
        tree = random_robot(rng, int(rng.integers(2, 7))).tree()
    some = rng.choice(np.flatnonzero([joint.revolute for joint in tree.joints]), 2, replace=False)
    turn = np.zeros(tree.n)
    turn[some] = rng.uniform(0.5, 2, 2) * rng.choice([-1, 1], 2)
    tree = with_shafts(tree, {"shaft": {tree.names[k]: float(turn[k]) for k in some}})
    clean = ideal(tree, seed=int(rng.integers(100)))
    assert clean.velocity is not None
    assert clean.acceleration is not None
    speed, faster = clean.velocity @ turn, clean.acceleration @ turn
    rubs = (1.5 * np.sign(speed) + 0.7 * speed + 0.2 * faster)[:, None] * turn
    terms = [f"{kind}/shaft" for kind in ("coulomb", "viscous", "rotor")]
    asked = replace(EXACT, terms=terms, deadband=0.0)
    found = tb.identify(tree, plus(clean, torque=rubs), "internal", settings=asked)
    assert found.drives is not None
    assert verify_drives(tree, found.drives).holds
    truth = found.drives.values(tb.barycentric(tree), tree)
    truth = truth + found.drives.columns @ [1.5, 0.7, 0.2]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()
    states = clean.time, clean.position, clean.velocity, clean.acceleration
    if "rotor/shaft" in found.names:  # else a body holds it
        np.testing.assert_allclose(own_torque(tb.Motion(*states), found), rubs, atol=1e-6)


@pytest.mark.parametrize(
    ("given", "culprit"),
    [
        ({"motor": {"j1": 1.0}}, "motor"),
        ({"motor": {"j1": 1.0, "j2": 0.0}}, "motor"),
        ({"j1": {"j1": 1.0, "j2": 1.0}}, "j1"),
        ({"a": {"j1": 1.0, "j2": 1.0}, "b": {"j1": -2.0, "j2": -2.0}}, "'b'"),
        ({"motor": {"j1": 1.0, "j3": 1.0}}, "motor"),
    ],
)
def test_what_is_no_shaft_is_refused(given: dict[str, dict[str, float]], culprit: str) -> None:
    """One joint, a turn of zero, a joint's name, the same shaft again, a joint that slides."""
    with refuses(ModelError, culprit):
        with_shafts(chain(Z, Y, X, last="prismatic"), given)
