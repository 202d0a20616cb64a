"""Bodies and drives together: which term has a column of its own, by structure and by sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.dynamics.witnesses import verify_drives
from testbed.errors import UnknownName
from testbed.parameters.joint_terms import DriveSet, with_joint_terms
from testbed.robot.friction import COULOMB, LAWS, OFFSET, ROTOR, VISCOUS, JointLaw
from testbed.robot.tree import Tree
from tests.helpers.chains import X, Y, Z, chain
from tests.helpers.strategies import trees

ASKED = ((ROTOR,), (OFFSET,), (OFFSET, ROTOR), LAWS)


def drives(tree: Tree, *laws: str | JointLaw, zeros: object = False) -> DriveSet:
    return with_joint_terms(tree, tb.minimal_set(tree, "dynamic", zeros=zeros), laws)  # type: ignore[arg-type]


def own(found: DriveSet) -> list[str]:
    return [found.symbol(term).text for term in found.terms]


@given(trees(), st.sampled_from(ASKED))
def test_sampled_columns_have_the_rank_and_are_reproduced(
    tree: Tree, laws: tuple[JointLaw, ...]
) -> None:
    agreement = verify_drives(tree, drives(tree, *laws))
    assert agreement.holds, agreement
    assert agreement.change < 1e-11
    friction = drives(tree, COULOMB, VISCOUS, OFFSET)  # these are always told apart
    assert friction.terms == friction.asked
    assert not friction.regrouped


def test_a_rotor_at_the_root_is_one_with_the_inertia_there(puma: Tree) -> None:
    found = drives(puma, "rotor", zeros=True)
    assert own(found) == ["rotor/elbow"]
    assert found.names[:9] == (
        *("mb3z", "K3yy", "2*K3d", "K3yz", "mb*2z", "K*2yy+rotor/shoulder"),
        *("2*K*2d", "K*2yz", "K*1zz+rotor/waist"),
    )
    said = {str(formula) for formula in found.formulas}
    assert "K*1zz + rotor/waist = K1zz + K*2xx/2 + K*2zz/2 + rotor/waist" in said
    assert r"\mathrm{rotor}_{\mathrm{waist}}" in found.formulas[8].latex()


def test_what_tells_a_rotor_from_the_bodies() -> None:
    """Slides, weight, parallel axes, branches and known zeros; each against sampling, too."""
    weighing, still = chain(("prismatic", Z)), replace(chain(("prismatic", Z)), gravity=np.zeros(3))
    slide = drives(chain(("prismatic", X), ("revolute", Z)), "rotor")
    assert {"mbar1+rotor/j1", "K2zz+rotor/j2"} <= set(slide.names)
    told = {
        (weighing, "rotor"): ("mbar1", "rotor/j1"),
        (weighing, "rotor", "offset"): ("mbar1+rotor/j1", "offset/j1-9.81*rotor/j1"),
        (still, "rotor"): ("mbar1+rotor/j1",),
        (still, "rotor", "offset"): ("mbar1+rotor/j1", "offset/j1"),
        (chain(("revolute", Z)), "rotor"): ("K1zz+rotor/j1",),
    }
    for (tree, *laws), names in told.items():
        found = drives(tree, *laws)  # type: ignore[arg-type]
        assert found.names == names
        assert verify_drives(tree, found).holds  # type: ignore[arg-type]
    assert drives(chain(("revolute", Z)), "rotor", zeros=["K1zz"]).names == ("rotor/j1",)
    assert own(drives(chain(("revolute", Z), ("revolute", Z)), "rotor")) == ["rotor/j2"]
    trunk = chain(("revolute", Z), ("revolute", Y))
    branch = replace(trunk.joints[1], name="j3", body="b3")
    fork = Tree("fork", (*trunk.joints, branch), (*trunk.inertias, trunk.inertias[1]))
    found = drives(fork, "rotor")
    assert own(found) == own(drives(trunk, "rotor")) == []
    assert {"K*1zz+rotor/j1", "K2yy+rotor/j2", "K3yy+rotor/j3"} <= set(found.names)
    assert verify_drives(fork, found).holds


def test_the_unknowns_of_a_robot_are_matrix_times_its_parameters(puma: Tree) -> None:
    tree = puma.with_joints(
        {n: {"rotor_inertia": r} for n, r in zip(puma.names, (1.14, 4.75, 0.86), strict=True)}
    )
    found, theta = drives(tree, ROTOR, COULOMB, VISCOUS), tb.barycentric(tree)
    terms = [law.coefficients(tree) for law in (ROTOR, COULOMB, VISCOUS)]
    wanted = found.matrix @ np.concatenate([theta.ravel(), *terms])
    np.testing.assert_allclose(found.values(theta, tree), wanted, rtol=1e-14)
    waist = found.names.index("K*1zz+rotor/waist")
    plain = found.minimal.values(theta)[found.minimal.names.index("K*1zz")]
    assert found.values(theta, tree)[waist] == pytest.approx(plain + 1.14, rel=1e-14)
    units = dict(zip(found.names, found.units, strict=True))
    assert (units["K*1zz+rotor/waist"], units["viscous/elbow"]) == ("kg m^2", "N m s/rad")
    cubic = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3, None)
    ones_own = drives(puma, cubic, "rotor")
    assert own(ones_own) == ["cubic/waist", "cubic/shoulder", "cubic/elbow", "rotor/elbow"]
    assert verify_drives(puma, ones_own).holds


def test_terms_belong_to_the_torques(puma: Tree) -> None:
    with pytest.raises(ValueError, match="reaction"):
        with_joint_terms(puma, tb.minimal_set(puma, "reaction"), ["rotor"])
    with pytest.raises(UnknownName, match="rotro.*rotor"):
        drives(puma, "rotro")
