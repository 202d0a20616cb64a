"""What joints add of their own: any law, any combination, on any tree."""

from __future__ import annotations

import ast
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.identification.predict import own_torque, predictions
from testbed.recordings.recording import Recording
from testbed.robot.friction import COULOMB, LAWS, ROTOR, VISCOUS, JointLaw
from tests.helpers.cases import cases
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

pytestmark = pytest.mark.slow

ROBOTS = ("puma560_3", "ur5", "gantry_ppp_rrr", "kuka_lwr4", "scara_rrpr", "two_trunks", "stanford")
KINDS = tuple(law.kind for law in LAWS)
COMBINATIONS = tuple(some for k in range(5) for some in combinations(KINDS, k))

ASYMMETRIC = JointLaw("asymmetric", "N m", "N", lambda qd, qdd: 1.0 * (qd > 0), resists=True)
CUBIC = JointLaw("cubic", "N m s^3/rad^3", "N s^3/m^3", lambda qd, qdd: qd**3)


def geared(tree: tb.Tree, seed: int = 0) -> tb.Tree:
    """With friction and rotors at every joint."""
    rng = np.random.default_rng(seed)
    joints = [
        replace(j, coulomb=a, viscous=b, rotor_inertia=c)
        for j, (a, b, c) in zip(tree.joints, rng.uniform(0.5, 2, (tree.n, 3)), strict=True)
    ]
    return replace(tree, joints=tuple(joints))


def golden(name: str) -> tb.Tree:
    return tb.load_tree(GOLDEN / f"robots/{name}.urdf", weld_root=True)


def without(tree: tb.Tree, kinds: tuple[str, ...]) -> tb.Tree:
    """The tree whose joints have only some of the file's terms."""
    fields = {law.parameter for law in LAWS if law.parameter and law.kind not in kinds}
    joints = [replace(joint, **dict.fromkeys(fields, 0.0)) for joint in tree.joints]  # type: ignore[arg-type]
    return replace(tree, joints=tuple(joints))


def rank(tree: tb.Tree, recording: Recording, kinds: tuple[str, ...]) -> int:
    """Of the torque regressor with all terms' columns: what can be told at all."""
    assert recording.velocity is not None
    assert recording.acceleration is not None
    states = (recording.position, recording.velocity, recording.acceleration)
    motion = tb.Motion(recording.time, *states)
    minimal = tb.minimal_set(tree, "dynamic")
    parts = [tb.regressor(tree, motion, minimal)]
    for law in LAWS:
        if law.kind in kinds:
            columns = np.broadcast_to(law.column(motion.qd, motion.qdd), motion.qd.shape)
            parts.append(columns[:, :, None] * np.eye(tree.n))
    phi = np.concatenate(parts, axis=2).reshape(-1, sum(part.shape[2] for part in parts))
    scale = np.linalg.norm(phi, axis=0)
    return int(np.linalg.matrix_rank(phi / np.where(scale > 0, scale, 1.0), tol=1e-8))


@pytest.mark.parametrize("kinds", COMBINATIONS, ids="+".join)
@pytest.mark.parametrize("robot", cases([*ROBOTS, *range(8)], fast=2))
def test_no_combination_of_terms_fails_for_a_structural_reason(
    robot: str | int, kinds: tuple[str, ...]
) -> None:
    """As many unknowns as a rank says; every one as the model file has it."""
    if isinstance(robot, str):
        tree = golden(robot)
    else:
        tree = random_robot(np.random.default_rng(robot), 1 + robot % 5).tree()
    tree = without(geared(tree), kinds)
    offsets = np.linspace(-1, 1, tree.n) * ("offset" in kinds)
    recording = ideal(tree, own={LAWS[2]: offsets})
    settings = replace(EXACT, terms=kinds, deadband=0.0)
    found = tb.identify(tree, recording, "internal", settings=settings)
    assert len(found.names) == rank(tree, recording, kinds)
    assert len(set(found.names)) == len(found.names)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    for k, term in enumerate(found.drives.terms):
        if term.law.kind == "offset":
            truth[found.minimal.count + k] += offsets[term.joint]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()


@pytest.mark.parametrize("kinds", [("rotor",), KINDS], ids="+".join)
@pytest.mark.slow
def test_a_humanoid_knows_which_rotors_it_cannot_tell(kinds: tuple[str, ...]) -> None:
    tree = without(geared(golden("humanoid_pelvis")), kinds)
    recording = ideal(tree, duration=20.0)
    settings = replace(EXACT, terms=kinds, deadband=0.0)
    found = tb.identify(tree, recording, "internal", settings=settings)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    assert np.abs(found.values - truth).max() <= 1e-6 * np.abs(truth).max()


def test_a_rotor_is_named_with_the_inertia_that_hides_it(puma: tb.Tree) -> None:
    """The elbow's turns with the shoulder's axis, and so tells its rotor from its body."""
    tree = geared(puma)
    recording = ideal(tree)
    settings = replace(EXACT, terms=("coulomb", "viscous", "rotor"))
    found = tb.identify(tree, recording, "internal", zeros=True, settings=settings)
    values = dict(zip(found.names, found.values, strict=True))
    plain = tb.minimal_set(puma, "dynamic", zeros=True)
    own = dict(zip(plain.names, plain.values(tb.barycentric(puma)), strict=True))
    rotors = [joint.rotor_inertia for joint in tree.joints]
    for name, joint, rotor in zip(("K*1zz", "K*2yy"), tree.names, rotors, strict=False):
        assert values[f"{name}+rotor/{joint}"] == pytest.approx(own[name] + rotor, rel=1e-9)
    assert values["rotor/elbow"] == pytest.approx(rotors[2], rel=1e-9)
    assert [t.joint for t in found.joint_terms if t.kind == "rotor"] == ["elbow"]


def test_an_estimate_knows_its_parts(puma: tb.Tree) -> None:
    tree = without(geared(puma), ("coulomb", "viscous"))
    recording = ideal(tree)
    internal = tb.identify(tree, recording, "internal", zeros=True, settings=EXACT)
    base, terms = internal.base, internal.joint_terms
    assert (*base.names, *(term.name for term in terms)) == internal.names
    assert (*base.units, *(term.unit for term in terms)) == internal.units
    joined = [*base.values, *(term.value for term in terms)]
    np.testing.assert_array_equal(joined, internal.values)
    np.testing.assert_array_equal([*base.sigma, *(term.sigma for term in terms)], internal.sigma)
    np.testing.assert_array_equal(np.sqrt(np.diagonal(base.covariance)), base.sigma)
    theta = tb.barycentric(puma).ravel()
    np.testing.assert_allclose(base.matrix @ theta, base.values, rtol=1e-8)
    assert [(term.kind, term.joint) for term in terms] == [
        (kind, joint) for kind in ("coulomb", "viscous") for joint in tree.names
    ]
    external = tb.identify(tree, recording, "external", zeros=True, settings=EXACT)
    assert external.joint_terms == ()
    assert (external.base.model, base.model) == ("reaction", "dynamic")
    assert external.base.names == external.names
    for array in (base.values, internal.values, internal.covariance, internal.residual):
        assert not array.flags.writeable


@pytest.mark.parametrize("engine", ["small", "large"])
@pytest.mark.parametrize("law", [ASYMMETRIC, CUBIC], ids=lambda law: law.kind)
def test_a_law_of_ones_own_goes_all_the_way(
    law: JointLaw, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Defined here and nowhere else: recorded, identified and predicted, whatever the engine."""
    if engine == "large":
        monkeypatch.setattr("testbed.identification.passes.SMALL", 0.0)
    tree = golden("gantry_ppp_rrr")
    coefficients = np.linspace(0.5, 3.0, tree.n)
    recording = ideal(tree, own={law: coefficients})
    settings = replace(EXACT, terms=("coulomb", law, "viscous"))
    found = tb.identify(tree, recording, "internal", settings=settings)
    terms = [term for term in found.joint_terms if term.kind == law.kind]
    assert [term.name for term in terms] == [f"{law.kind}/{name}" for name in tree.names]
    assert [term.unit for term in terms] == [law.unit(joint) for joint in tree.joints]
    np.testing.assert_allclose([term.value for term in terms], coefficients, rtol=1e-8)
    motion = tb.Motion(recording.time, *kinematics(recording))
    torque = predictions(tree, recording, motion, {"internal": found})[1]["internal"]
    np.testing.assert_allclose(torque, recording.measured("torque"), atol=1e-7)
    expected = coefficients * law.column(motion.qd, motion.qdd)
    np.testing.assert_allclose(own_torque(motion, found), expected, atol=1e-7)


def kinematics(recording: Recording) -> tuple[Array, Array, Array]:
    assert recording.velocity is not None
    assert recording.acceleration is not None
    return recording.position, recording.velocity, recording.acceleration


def test_a_law_that_is_there_already_is_refused() -> None:
    twin = JointLaw("viscous", "N m s/rad", "N s/m", lambda qd, qdd: qd)
    with pytest.raises(tb.TestbedError, match="twice"):
        tb.Settings(terms=("viscous", twin))


def words(path: Path) -> set[str]:
    """Texts that a module holds, but for its docstrings."""
    found = ast.walk(ast.parse(path.read_text()))
    return {n.value for n in found if isinstance(n, ast.Constant) and isinstance(n.value, str)}


def test_names_of_laws_are_spelt_in_one_place() -> None:
    """Beside the defaults of the settings."""
    rooms = ("kernel", "excitation", "simulation", "identification", "cli")
    for path in (each for room in rooms for each in (ROOT / "testbed" / room).rglob("*.py")):
        if path.name != "settings.py":
            spelt = [law.kind for law in (COULOMB, VISCOUS, ROTOR) if law.kind in words(path)]
            assert not spelt, f"{path} spells {spelt}"
