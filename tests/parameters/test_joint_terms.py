"""Bodies and drives together: which term has a column of its own, by structure and by sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.witnesses import verify_drives
from testbed.errors import UnknownName
from testbed.parameters.barycentric import parameter_names
from testbed.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.robot.friction import COULOMB, LAWS, OFFSET, ROTOR, VISCOUS, JointLaw
from testbed.robot.tree import Joint, Tree
from tests.helpers.paths import GOLDEN, REAL
from tests.helpers.robots import random_robot

GRAVITIES = ((0.0, 0.0, -9.81), (2.97, -4.95, -7.93), (0.0, 0.0, 0.0))
ASKED = ((ROTOR,), (OFFSET,), (OFFSET, ROTOR), LAWS)
X, Y, Z = np.eye(3)


def drives(tree: Tree, *laws: str | JointLaw, zeros: object = False) -> DriveSet:
    return with_joint_terms(tree, tb.minimal_set(tree, "dynamic", zeros=zeros), laws)  # type: ignore[arg-type]


def own(found: DriveSet) -> list[str]:
    return [found.symbol(term).text for term in found.terms]


def chain(*joints: tuple[str, np.ndarray], offset: float = 0.3) -> Tree:
    """Joints of given kinds and axes, each a step aside of the one before, on general bodies."""
    rng = np.random.default_rng(len(joints))
    made = tuple(
        Joint(f"j{k + 1}", f"b{k + 1}", kind, k - 1, axis, np.full(3, offset * (k > 0)), np.eye(3))  # type: ignore[arg-type]
        for k, (kind, axis) in enumerate(joints)
    )
    bodies = tuple(
        tb.Inertia.about_centre(rng.uniform(1, 3), rng.uniform(-0.2, 0.2, 3), np.eye(3) * 0.1)
        for _ in joints
    )
    return Tree("chain", made, bodies)


@pytest.mark.parametrize("seed", range(30_000, 30_045))
def test_sampled_columns_have_the_rank_and_are_reproduced(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, 9)), gravity=GRAVITIES[seed % 3])
    tree = robot.tree()
    for laws in ASKED:
        found = drives(tree, *laws)
        agreement = verify_drives(tree, found)
        assert agreement.holds, agreement
        assert agreement.change < 1e-11


def test_a_rotor_at_the_root_is_one_with_the_inertia_there(puma: tb.Tree) -> None:
    found = drives(puma, "rotor", zeros=True)
    assert own(found) == ["rotor/elbow"]
    assert found.names[:9] == (
        *("mb3z", "K3yy", "2*K3d", "K3yz", "mb*2z", "K*2yy+rotor/shoulder"),
        *("2*K*2d", "K*2yz", "K*1zz+rotor/waist"),
    )
    said = {str(formula) for formula in found.formulas}
    assert "K*1zz + rotor/waist = K1zz + K*2xx/2 + K*2zz/2 + rotor/waist" in said
    assert "K*2yy + rotor/shoulder = K2yy + rotor/shoulder" in said
    assert (
        found.formulas[8]
        .latex()
        .startswith(r"K^{*1}_{zz} + \mathrm{rotor}_{\mathrm{waist}} = K^{1}_{zz}")
    )


def test_a_rotor_of_a_first_slide_is_one_with_the_total_mass() -> None:
    found = drives(chain(("prismatic", X), ("revolute", Z)), "rotor")
    assert {"mbar1+rotor/j1", "K2zz+rotor/j2"} <= set(found.names)
    assert own(found) == []


def test_weight_tells_the_mass_of_a_vertical_slide_from_its_rotor() -> None:
    """Unless an offset takes up the weight."""
    tree = chain(("prismatic", Z))
    assert drives(tree, "rotor").names == ("mbar1", "rotor/j1")
    with_offset = drives(tree, "rotor", "offset")
    assert with_offset.names == ("mbar1+rotor/j1", "offset/j1-9.81*rotor/j1")
    assert verify_drives(tree, with_offset).holds
    floating = replace(tree, gravity=np.zeros(3))
    assert drives(floating, "rotor").names == ("mbar1+rotor/j1",)
    assert drives(floating, "rotor", "offset").names == ("mbar1+rotor/j1", "offset/j1")


def test_parallel_axes_tell_rotors_apart() -> None:
    """Two parallel axes: the second body's inertia is felt at the first, its rotor is not."""
    assert own(drives(chain(("revolute", Z), ("revolute", Z)), "rotor")) == ["rotor/j2"]
    assert own(drives(chain(("revolute", Z), ("revolute", Y)), "rotor")) == []


def test_every_branch_hides_its_own_rotors() -> None:
    trunk = chain(("revolute", Z), ("revolute", Y))
    branch = replace(trunk.joints[1], name="j3", body="b3")
    tree = Tree("fork", (*trunk.joints, branch), (*trunk.inertias, trunk.inertias[1]))
    found = drives(tree, "rotor")
    assert own(found) == []
    assert {"K*1zz+rotor/j1", "K2yy+rotor/j2", "K3yy+rotor/j3"} <= set(found.names)
    assert verify_drives(tree, found).holds


def test_friction_and_offsets_always_have_columns_of_their_own() -> None:
    for seed in range(20):
        tree = random_robot(np.random.default_rng(seed), 6).tree()
        found = drives(tree, "coulomb", "viscous", "offset")
        assert found.terms == found.asked
        assert not found.regrouped


def test_zeros_can_tell_a_rotor_from_an_inertia_that_is_known() -> None:
    """K1zz known to be zero: its rotor is told alone."""
    tree = chain(("revolute", Z))
    assert drives(tree, "rotor").names == ("K1zz+rotor/j1",)
    known = drives(tree, "rotor", zeros=["K1zz"])
    assert known.names == ("rotor/j1",)
    assert verify_drives(tree, known).holds


@pytest.mark.parametrize(("seed", "told"), [(26, "rotor/j1-rotor/j4"), (360, "rotor/j2-0.371036")])
def test_a_rotor_may_be_told_only_against_another(seed: int, told: str) -> None:
    """Where known zeros make two joints move one inertia, each with its rotor."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    tree = random_robot(rng, n, gravity=GRAVITIES[seed % 3]).tree()
    zeros = [name for name in parameter_names(tree) if rng.random() < 0.7]
    found = drives(tree, "offset", "rotor", zeros=zeros)
    assert any(name.startswith(told) for name in found.names)
    assert verify_drives(tree, found).holds


def test_the_unknowns_of_a_robot_are_matrix_times_its_parameters(puma: tb.Tree) -> None:
    rotors = (1.14, 4.75, 0.86)
    joints = [replace(j, rotor_inertia=r) for j, r in zip(puma.joints, rotors, strict=True)]
    tree = replace(puma, joints=tuple(joints))
    found = drives(tree, ROTOR, COULOMB, VISCOUS)
    theta = tb.barycentric(tree)
    terms = [law.coefficients(tree) for law in (ROTOR, COULOMB, VISCOUS)]
    expected = found.matrix @ np.concatenate([theta.ravel(), *terms])
    np.testing.assert_allclose(found.values(theta, tree), expected, rtol=1e-14)
    waist = found.names.index("K*1zz+rotor/waist")
    plain = found.minimal.values(theta)[found.minimal.names.index("K*1zz")]
    assert found.values(theta, tree)[waist] == pytest.approx(plain + 1.14, rel=1e-14)
    assert dict(zip(found.names, found.units, strict=True))["K*1zz+rotor/waist"] == "kg m^2"
    assert dict(zip(found.names, found.units, strict=True))["viscous/elbow"] == "N m s/rad"


def test_a_law_of_ones_own_has_columns_of_its_own(puma: tb.Tree) -> None:
    cubic = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3, None)
    found = drives(puma, cubic, "rotor")
    assert own(found) == ["cubic/waist", "cubic/shoulder", "cubic/elbow", "rotor/elbow"]
    assert verify_drives(puma, found).holds


def test_terms_belong_to_the_torques(puma: tb.Tree) -> None:
    with pytest.raises(ValueError, match="dynamic set, this is the reaction one"):
        with_joint_terms(puma, tb.minimal_set(puma, "reaction"), ["rotor"])
    with pytest.raises(UnknownName, match="'rotro'; did you mean 'rotor'"):
        drives(puma, "rotro")


@pytest.mark.parametrize(
    "path",
    [
        GOLDEN / "robots/gantry_ppp_rrr.urdf",
        REAL / "ur_description/urdf/ur5_robot.urdf",
        REAL / "double_pendulum_description/urdf/double_pendulum.urdf",
    ],
    ids=lambda path: path.stem,
)
@pytest.mark.parametrize("zeros", [False, True])
def test_real_robots(path: object, zeros: bool) -> None:
    tree = tb.load_tree(path)  # type: ignore[arg-type]
    for laws in ASKED:
        assert verify_drives(tree, drives(tree, *laws, zeros=zeros)).holds


def test_a_set_that_lacks_a_term_is_caught(puma: tb.Tree) -> None:
    """And the numbers say which way: fewer unknowns than the columns' rank."""
    whole = drives(puma, "coulomb")
    assert verify_drives(puma, whole).holds
    lacking = replace(whole, terms=whole.terms[:-1], columns=whole.columns[:-1])
    found = verify_drives(puma, lacking)
    assert (found.count, found.sampled) == (whole.count - 1, whole.count)
    assert not found.holds
    assert found.change > 0.01
