"""Bodies, joints and shafts together: which term of the torques has a column of its own.

If one fails, friction or a rotor is told twice, or what could be told is given to a body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.validate import motion_in, own_torque
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.dynamics.rank_check import verify_drives
from testbed.core.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.core.robot.friction import COULOMB, LAWS, OFFSET, ROTOR, VISCOUS, JointLaw
from testbed.core.robot.shafts import with_shafts
from testbed.core.robot.tree import Tree
from tests.helpers.chains import X, Y, Z, chain
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.strategies import Rng, few, rngs, trees

ASKED = ((ROTOR,), (OFFSET,), (OFFSET, ROTOR), LAWS)


def drives(tree: Tree, *laws: str | JointLaw, zeros: bool | Sequence[str] = False) -> DriveSet:
    """What can be told, which sampled columns confirm."""
    found = drive_set(tree, tb.minimal_set(tree, "dynamic", zeros=zeros), laws)
    assert verify_drives(tree, found).holds
    return found


def turning(*axes: np.ndarray) -> Tree:
    return chain(*(("revolute", axis) for axis in axes))


@given(trees(), st.sampled_from(ASKED))
def test_sampled_columns_have_the_rank_of_the_set(tree: Tree, laws: tuple[JointLaw, ...]) -> None:
    assert verify_drives(tree, drives(tree, *laws)).change < 1e-11
    friction = drives(tree, COULOMB, VISCOUS, OFFSET)  # these are always told apart
    assert friction.terms == friction.asked
    assert not friction.regrouped


def test_unknowns_of_the_puma_have_names_formulas_units_and_values(puma: Tree) -> None:
    """A rotor at the root is one with the inertia there."""
    found = drives(puma, "rotor", zeros=True)
    assert found.names == (
        *("mb3z", "K3yy", "2*K3d", "K3yz", "mb*2z", "K*2yy+rotor/shoulder"),
        *("2*K*2d", "K*2yz", "K*1zz+rotor/waist", "rotor/elbow"),
    )
    said = {str(formula) for formula in found.formulas}
    assert "K*1zz + rotor/waist = K1zz + K*2xx/2 + K*2zz/2 + rotor/waist" in said
    assert r"\mathrm{rotor}_{\mathrm{waist}}" in found.formulas[8].latex()
    spinning = dict(zip(puma.names, (1.14, 4.75, 0.86), strict=True))
    tree = puma.with_joints({name: {"rotor_inertia": r} for name, r in spinning.items()})
    found, theta = drives(tree, ROTOR, COULOMB, VISCOUS), tb.barycentric(tree)
    terms = [law.coefficients(tree) for law in (ROTOR, COULOMB, VISCOUS)]
    wanted = found.matrix @ np.concatenate([theta.ravel(), *terms])
    np.testing.assert_allclose(found.values(theta, tree), wanted, rtol=1e-14)
    units = dict(zip(found.names, found.units, strict=True))
    assert (units["K*1zz+rotor/waist"], units["viscous/elbow"]) == ("kg m^2", "N m s/rad")
    cubic = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3, None)
    ones_own = drives(puma, cubic, "rotor").names[-4:]
    assert ones_own == ("cubic/waist", "cubic/shoulder", "cubic/elbow", "rotor/elbow")
    with refuses(ValueError, "reaction"):
        with_joint_terms(puma, tb.minimal_set(puma, "reaction"), ["rotor"])


def test_what_tells_a_rotor_or_a_shaft_from_the_bodies_and_from_each_other() -> None:
    """By hand: slides, weight, parallel axes, branches, known zeros, shafts of two joints."""
    weighing, still = chain(("prismatic", Z)), replace(chain(("prismatic", Z)), gravity=np.zeros(3))
    for tree, laws, names in (
        (weighing, ["rotor"], ("mbar1", "rotor/j1")),
        (weighing, ["rotor", "offset"], ("mbar1+rotor/j1", "offset/j1-9.81*rotor/j1")),
        (still, ["rotor"], ("mbar1+rotor/j1",)),
        (still, ["rotor", "offset"], ("mbar1+rotor/j1", "offset/j1")),
        (turning(Z), ["rotor"], ("K1zz+rotor/j1",)),
    ):
        assert drives(tree, *laws).names == names
    assert drives(turning(Z), "rotor", zeros=["K1zz"]).names == ("rotor/j1",)
    trunk = turning(Z, Y)
    branch = replace(trunk.joints[1], name="j3", body="b3")
    fork = Tree("fork", (*trunk.joints, branch), (*trunk.inertias, trunk.inertias[1]))
    wrist, parallel = (
        with_shafts(turning(*axes), {"motor": {"j1": 1.0, "j2": 1.0}}) for axes in ((Z, Y), (Z, Z))
    )
    two = {"left": {"j1": 0.5, "j2": 0.5}, "right": {"j1": 0.5, "j2": -0.5}}
    both = with_shafts(trunk, two)  # (a + b)^2 + (a - b)^2 = 2 a^2 + 2 b^2
    for tree, law, told in (
        (chain(("prismatic", X), ("revolute", Z)), "rotor", {"mbar1+rotor/j1", "K2zz+rotor/j2"}),
        (turning(Z, Z), "rotor", {"K*1zz+rotor/j1", "rotor/j2"}),
        (fork, "rotor", {"K*1zz+rotor/j1", "K2yy+rotor/j2", "K3yy+rotor/j3"}),
        (wrist, "coulomb", {"coulomb/j1", "coulomb/j2", "coulomb/motor"}),
        (wrist, "offset", {"offset/j1", "offset/j2"}),  # the joints have theirs
        (parallel, "rotor/motor", {"K2zz+rotor/motor"}),  # q1 + q2: so turns the second body
        (both, "coulomb", {f"coulomb/{each}" for each in ("j1", "j2", "left", "right")}),
    ):
        kind, found = law.partition("/")[0], drives(tree, law)
        assert {name for name in found.names if kind in name} == told
    assert sum(name.startswith("viscous") for name in drives(both, "viscous").names) == 3
    single = drives(turning(Z, Z, Y), "coulomb", "rotor/j2", "offset/j3").names[-5:]
    assert single == ("coulomb/j1", "coulomb/j2", "coulomb/j3", "rotor/j2", "offset/j3")


@few(10)
@given(rngs)
def test_what_a_shaft_takes_is_found_and_foretold(rng: Rng) -> None:
    """Dry and viscous friction and inertia act on the joints by the shaft's power."""
    turning: list[int] = []
    while len(turning) < 2:
        tree = random_robot(rng, int(rng.integers(2, 7))).tree()
        turning = [k for k, joint in enumerate(tree.joints) if joint.revolute]
    some, turn = rng.choice(turning, 2, replace=False), np.zeros(tree.n)
    turn[some] = rng.uniform(0.5, 2, 2) * rng.choice([-1, 1], 2)
    tree = with_shafts(tree, {"shaft": {tree.names[k]: float(turn[k]) for k in some}})
    clean = ideal(tree, seed=int(rng.integers(100)))
    motion, _ = motion_in(clean)
    speed, faster = motion.qd @ turn, motion.qdd @ turn
    rubs = (1.5 * np.sign(speed) + 0.7 * speed + 0.2 * faster)[:, None] * turn
    terms = [f"{kind}/shaft" for kind in ("coulomb", "viscous", "rotor")]
    asked = replace(EXACT, terms=terms, deadband=0.0)
    found = tb.identify(tree, plus(clean, torque=rubs), "internal", settings=asked)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    truth = truth + found.drives.columns @ [1.5, 0.7, 0.2]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()
    if "rotor/shaft" in found.names:  # else a body holds it
        np.testing.assert_allclose(own_torque(motion, found), rubs, atol=1e-6)


def test_what_is_no_shaft_or_no_term_is_refused() -> None:
    """One joint, a turn of zero, a joint's name, the same shaft again, a joint that slides."""
    tree, two = chain(("revolute", Z), ("revolute", Y), ("prismatic", X)), {"j1": 1.0, "j2": 1.0}
    for shafts, culprit in (
        ({"motor": {"j1": 1.0}}, "motor"),
        ({"motor": {"j1": 1.0, "j2": 0.0}}, "motor"),
        ({"j1": two}, "j1"),
        ({"a": two, "b": {"j1": -2.0, "j2": -2.0}}, "'b'"),
        ({"motor": {"j1": 1.0, "j3": 1.0}}, "motor"),
    ):
        with refuses(ModelError, culprit):
            with_shafts(tree, shafts)
    for term, culprit in (("rotor/j4", "j4"), ("rotro", "rotor")):
        with refuses(UnknownName, culprit):
            drives(tree, term)
    with refuses(UnknownName, "glue"):
        tb.Settings(terms=("glue/j1",))
