"""Parameters and minimal sets, held by witnesses that share no code with rules.

If one fails, users identify a combination that is not what its formula says, or miss one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.prediction import joint_term_torque, longest_segment_motion
from testbed.bodies.prior import MIN_PRIOR_MOMENT_RATIO, PriorBodies, prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.dynamics.drive_set import make_drive_set
from testbed.core.dynamics.rank_check import sampled_regressor, verify_drive_set, verify_minimal_set
from testbed.core.parameters.elimination import barycentric_rows, static_wrench_parameters
from testbed.core.parameters.identifiability import (
    IDENTIFIABLE_ALONE,
    IDENTIFIABLE_IN_COMBINATION,
    NOT_IDENTIFIABLE,
    identifiability,
)
from testbed.core.parameters.pseudo_inertia import pseudo_inertias
from testbed.core.parameters.regroup import length_symbol, regroup_bodies
from testbed.core.parameters.rules import RULE_REASONS, Signal
from testbed.core.parameters.symbols import (
    Symbol,
    barycentric_from_standard,
    component_symbol,
    forms_on_standard,
    parameter_names,
    parameter_symbols,
    standard_from_barycentric,
)
from testbed.core.robot.friction import COULOMB, JOINT_LAWS, OFFSET, ROTOR, VISCOUS
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.rigid_matter import POINT_MASS_RADIUS_RATIO
from testbed.core.robot.shafts import with_shafts
from testbed.core.robot.tree import Tree
from tests.helpers.chains import X, Y, Z, chain
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.paths import GOLDEN
from tests.helpers.refusals import refuses
from tests.helpers.robots import Robot, random_robot, with_zeros
from tests.helpers.strategies import Rng, few, rngs, robots, seeds, trees

UNCHANGED = 1e-11  # relative change of the model by regrouping; lifts of short lengths are large
MODELS: tuple[Signal, ...] = ("torque", "wrench")
CATALOGUE = json.loads((GOLDEN / "counts.json").read_text())
OFF = np.zeros(3)


def all_sets(tree: Tree, zeros: bool | list[str] = False) -> list[tb.MinimalSet]:
    """Dynamic, bedplate and tared bedplate."""
    given_ = [("torque", False), ("wrench", False), ("wrench", True)]
    return [tb.minimal_set(tree, m, None, zeros, tared=t) for m, t in given_]  # type: ignore[arg-type]


def hold(tree: Tree, zeros: bool | list[str] = False) -> None:
    """Rules, exact recursion and sampled rank tell the same, in every set of a robot."""
    dynamic, *plates = all_sets(tree, zeros)
    theta, standard = tb.barycentric(tree), tb.standard(tree).ravel()
    for plate in plates:
        s = tb.selection(dynamic, plate)
        np.testing.assert_allclose(s @ plate.matrix, dynamic.matrix, atol=1e-9)
    for minimal in (dynamic, *plates):
        assert not minimal.lift[minimal.known_zero.ravel()].any()
        assert not minimal.matrix[:, minimal.known_zero.ravel()].any()
        delta, size = minimal.values(theta), max(1.0, np.abs(minimal.values(theta)).max(initial=0))
        np.testing.assert_allclose(minimal.standard_matrix @ standard, delta, atol=1e-12 * size)
        again = minimal.values(minimal.lift @ delta)
        np.testing.assert_allclose(again, delta, rtol=0, atol=1e-11 * size)
        found = verify_minimal_set(tree, minimal)
        assert found.agrees, found
        assert found.change <= UNCHANGED
    drives = verify_drive_set(tree, tb.with_joint_terms(tree, dynamic, JOINT_LAWS))
    assert drives.agrees, drives


@pytest.mark.slow
@example(691, 12, False, "none")  # these four have a first axis close to the vertical: large lifts
@example(815, 12, False, "none")
@example(1727, 12, False, "none")
@example(1996, 12, False, "none")
@given(seeds, st.integers(1, 12), st.booleans(), st.sampled_from(["none", "bodies", "any"]))
def test_three_witnesses_agree_on_any_tree(seed: int, most: int, floats: bool, zeros: str) -> None:
    """General bodies; masses on axes and massless links; zeros whether or not bodies have them."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(1, most + 1)))
    tree = (with_zeros(rng, robot) if zeros == "bodies" else robot).tree()
    tree = replace(tree, gravity=OFF) if floats else tree
    if zeros == "any":
        share = rng.choice([0.05, 0.3, 0.7, 0.95])
        hold(tree, [name for name in parameter_names(tree) if rng.random() < share])
    else:
        hold(tree, zeros == "bodies")
    for general, known in zip(all_sets(tree), all_sets(tree, True), strict=True):
        assert set(known.names) <= set(general.names)
    assert [each.count for each in all_sets(tree, list(parameter_names(tree)))] == [0, 0, 0]


# a set is believed because three computations agree: they must be able to disagree


@few(10)
@given(rngs, st.sampled_from(MODELS))
def test_the_right_set_is_confirmed_and_another_robots_is_not(rng: Rng, model: Signal) -> None:
    """Each witness alone speaks up."""
    tree, other = (random_robot(rng, 5).tree() for _ in range(2))
    minimal = tb.minimal_set(tree, model, tared=model == "wrench")
    found = verify_minimal_set(tree, minimal)
    assert found.agrees
    assert found.rules == found.recursion == found.sampled == minimal.count
    assert max(found.recursion_distance, found.sampled_distance) < 1e-9
    wrong = verify_minimal_set(tree, tb.minimal_set(other, model))
    assert not wrong.agrees
    assert wrong.rules != wrong.recursion or wrong.recursion_distance > 1e-3
    assert wrong.rules != wrong.sampled or wrong.sampled_distance > 1e-3
    assert wrong.change > 1e-3
    for spoiled in ("recursion_distance", "sampled_distance", "change", "inverse"):
        assert not replace(found, **{spoiled: 1e-3}).agrees  # type: ignore[arg-type]
    assert not replace(found, gap=999.0).agrees


# known robots


def test_counts_of_the_catalogue_are_those_counted_elsewhere() -> None:
    """18 robots under 4 gravities; `python -m benchmarks minimal` holds many by all witnesses."""
    for robot, said in CATALOGUE.items():
        tree = tb.load_tree(GOLDEN / "robots" / said["urdf"])
        for entry in said["gravity"].values():
            found = [tb.minimal_set(tree, m, entry["g"]).count for m in MODELS]
            assert found == [entry["N_d"], entry["N_r"]], robot


def starred(name: str) -> str:
    """mbs2z -> mb*2z, Ks1zz -> K*1zz, and what is named differently in the golden file."""
    others = {"K3d": "2*K3d", "Ks2d": "2*K*2d", "mm1": "mbar1"}
    return others.get(name, re.sub(r"^(mb|K)s", r"\1*", name))


def test_the_pumas_sets_are_the_papers(puma: Tree, golden: Any) -> None:
    """Names, order, values, and the printed column of table 6."""
    truth, theta = golden["variants"]["ref18_exact"], tb.barycentric(puma)
    names = [name.replace("mbar", "mm") for name in parameter_names(puma)]
    wanted = [truth["theta"][name] for name in names]
    np.testing.assert_allclose(theta.ravel(), wanted, rtol=1e-12, atol=1e-12)
    dynamic, reaction = (tb.minimal_set(puma, m, zeros=True) for m in MODELS)
    for minimal, key in ((dynamic, "delta_d"), (reaction, "delta_r")):
        assert list(minimal.names) == [starred(name) for name in golden[f"{key}_order"]]
        factor = [1 + name.startswith("2*") for name in minimal.names]
        printed = [truth[key][name] for name in golden[f"{key}_order"]]
        np.testing.assert_allclose(minimal.values(theta), np.multiply(factor, printed), rtol=1e-12)
    np.testing.assert_allclose(dynamic.values(theta), golden["table6"]["ref18"], rtol=1e-12)
    np.testing.assert_array_equal(tb.selection(dynamic, reaction), np.eye(9, 12))


def test_units_and_reasons_of_a_puma_with_general_bodies(puma: Tree) -> None:
    reaction = tb.minimal_set(puma, "wrench")
    assert set(reaction.reasons) == {"5.1", "5.2", "base"} <= set(RULE_REASONS)
    assert set(reaction.unidentifiable) == {"mb1z", "K1xx", "K1xy", "K1yy", "mbar2", "mbar3"}
    units = {"mbar": "kg", "mb": "kg m", "mb*": "kg m", "K": "kg m^2", "K*": "kg m^2"}
    stems = (re.match(r"(?:2\*)?([A-Za-z]+\*?)", name) for name in reaction.names)
    assert reaction.units == tuple(units[stem[1]] for stem in stems if stem)
    tared = tb.minimal_set(puma, "wrench", tared=True)
    assert set(reaction.names) - set(tared.names) == {"mbar1"}
    given_ = [f"{p}{k}{x}" for k in (1, 2, 3) for p, x in (("mb", "x"), ("K", "xy"), ("K", "xz"))]
    for model in MODELS:  # a user's zeros are as good as the file's
        wanted = tb.minimal_set(puma, model, zeros=True).names
        assert tb.minimal_set(puma, model, zeros=given_).names == wanted
    with pytest.raises(UnknownName, match="mb9x"):
        tb.minimal_set(puma, "torque", zeros=["mb9x"])


# traps


def test_axes_that_look_alike_are_told_apart() -> None:
    """Tilted by rounding; inclined."""
    rounded = chain(("revolute", (1e-12, 0.0, 1.0)), ("revolute", Y))
    assert [tb.minimal_set(rounded, m).count for m in MODELS] == [8, 13]
    inclined = tb.minimal_set(chain(("revolute", Z), ("revolute", (0.6, 0.0, 0.8))), "torque")
    assert {"mb2u", "mb2v", "K2ww", "2*K2d", "K2uv"} <= set(inclined.names)
    axes = inclined.triads[1].axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(axes[2], [0.6, 0.0, 0.8], atol=1e-15)


def test_moments_that_are_all_rounding_are_zero() -> None:
    """A file's zero may be 1e-17: small against a mass at a distance of the body's size."""
    inertia = tb.Inertia.about_centre(2.0, np.array([1e-17, 0.0, 0.0]), np.eye(3) * 0.1)
    tree = replace(chain(("revolute", Z)), inertias=(inertia,))
    minimal = tb.minimal_set(tree, "wrench", zeros=True)
    known = set(np.array(parameter_names(tree))[minimal.known_zero.ravel()].tolist())
    assert known == {"mb1x", "mb1y", "mb1z", "K1xy", "K1xz", "K1yz"}


models: st.SearchStrategy[Signal] = st.sampled_from(["torque", "wrench"])


@few(40)
@given(st.one_of(trees((1, 7)), trees((1, 7), bare=True)), rngs, models, st.booleans())
def test_formulas_state_the_matrix(tree: tb.Tree, rng: Rng, model: Signal, zeros: bool) -> None:
    """Each, evaluated on random parameters, gives S theta; what is known to be zero is not named.

    Auxiliary ones come before what refers to them, once each, and only where they are needed.
    """
    minimal = tb.minimal_set(tree, model, zeros=zeros)
    theta = np.where(minimal.known_zero, 0.0, rng.normal(size=(tree.n, 10)))
    given_ = zip(parameter_names(tree), theta.ravel().tolist(), strict=True)
    known = {name: value for name, value in given_ if value}
    for j, joint in enumerate(tree.joints):
        for x, length in zip("xyz", joint.offset, strict=True):
            known[length_symbol(joint.parent, j, x).text] = float(length)
    for formula in minimal.auxiliary:
        assert formula.left.text not in known
        known[formula.left.text] = evaluate(formula.right_text, known)
    for formula, value in zip(minimal.formulas, minimal.values(theta), strict=True):
        assert evaluate(formula.right_text, known) == pytest.approx(value, abs=1e-4), (
            formula
        )  # 6 digits
    both = (*minimal.formulas, *minimal.auxiliary)
    named = {term.symbol for formula in both for term in formula.right}
    told = {label.symbols[0] for label in minimal.labels if label.multiple == 1}
    starred = {s for s in named if isinstance(s, Symbol) and s.is_redefined}
    assert starred - told == {formula.left.symbols[0] for formula in minimal.auxiliary}
    assert minimal.names == tuple(label.text for label in minimal.labels)


def evaluate(text: str, known: dict[str, float]) -> float:
    """The value of a sum of products; a star inside a name belongs to the name."""
    names = sorted(known, key=len, reverse=True)
    pattern = re.compile("|".join(re.escape(n) for n in names if not n.startswith("2*")) or "$^")
    numbers = pattern.sub(lambda match: f"({known[match.group()]!r})", text)
    assert re.fullmatch(r"[-+*/(). 0-9e]*", numbers), (text, numbers)
    return float(eval(numbers))  # digits and operators only


def test_formulas_of_the_puma_are_the_papers(puma: tb.Tree) -> None:
    minimal = tb.minimal_set(puma, "wrench", zeros=True)
    said = {str(formula) for formula in (*minimal.formulas, *minimal.auxiliary)}
    assert {
        *("K*1yz = K1yz - l12z*mb*2y", "mb*1y = mb1y + mb*2y", "mb*2y = mb2y + mb3y"),
        *("K*2yz = K2yz - l23z*mb3y", "2*K3d = K3xx - K3zz", "K*1zz = K1zz + K*2xx/2 + K*2zz/2"),
        "K*2xx = K2xx + K3xx/2 + K3zz/2",
    } <= said
    numbers = map(str, tb.minimal_set(puma, "torque", zeros=True).formulas_with("numbers"))
    assert "K*2yz = K2yz - 0.4318*mb3y" in numbers
    latex = {f.left.text: f.latex() for f in minimal.formulas}
    assert latex["K*1yz"] == r"K^{*1}_{yz} = K^{1}_{yz} - l^{12}_{z}\,m\!b^{*2}_{y}"
    assert latex["K*1zz"].endswith(r" + \tfrac{1}{2}\,K^{*2}_{xx} + \tfrac{1}{2}\,K^{*2}_{zz}")
    assert latex["mbar1"] == r"\bar{m}^{1} = \bar{m}^{1}"
    assert latex["2*K3d"] == r"2\,K^{3}_{d} = K^{3}_{xx} - K^{3}_{zz}"


def test_every_name_is_one_parameters_beyond_the_ninth_body_too() -> None:
    tree = random_robot(np.random.default_rng(0), 12).tree()
    names = parameter_names(tree)
    assert len(set(names)) == len({symbol.latex for symbol in parameter_symbols(tree)}) == 120
    assert [length_symbol(*at).text for at in ((8, 9, "y"), (-1, 0, "x"))] == ["l9_10y", "l01x"]
    assert length_symbol(8, 9, "y").latex == "l^{9,10}_{y}"
    assert component_symbol(11, 0, star=True).text == "mbar12"  # a mass is never redefined


@given(robots(), rngs)
def test_standard_parameters_are_pinocchios_and_invertible(robot: Robot, rng: Rng) -> None:
    """In Pinocchio's order: else a mass that is printed is another one to every other program."""
    tree = robot.tree()
    rows, parameters = rng.normal(size=(3, 10 * tree.n)), rng.normal(size=(tree.n, 10))
    back = standard_from_barycentric(tree, barycentric_from_standard(tree, parameters))
    np.testing.assert_allclose(back, parameters, rtol=0, atol=1e-12)
    said = rows @ barycentric_from_standard(tree, parameters).ravel()
    np.testing.assert_allclose(forms_on_standard(tree, rows) @ parameters.ravel(), said, atol=1e-11)
    model = pin.buildModelFromXML(robot.urdf())
    for k, name in enumerate(tree.names):
        theirs = model.inertias[model.getJointId(name)].toDynamicParameters()
        np.testing.assert_allclose(tb.standard(tree)[k], theirs, rtol=0, atol=1e-12)


# the map


def beside_a_pedestal(tree: tb.Tree, tared: tb.MinimalSet) -> Array:
    """What is told with an unknown mass and two moments on the plate, (k, 3 + 10 n)."""
    bodies = regroup_bodies(tree, "wrench", tree.gravity)
    entries = static_wrench_parameters(tree, tree.gravity) if tree.gravity.any() else []
    static = np.where(tared.known_zero.ravel(), 0.0, barycentric_rows(tree, bodies, entries))
    own = np.eye(3)[: len(static)]
    return np.block([[np.zeros((tared.count, 3)), tared.matrix], [own, static]])


def levels_by_orthonormal_rows(rows: Array) -> Array:
    basis = np.linalg.qr(rows.T)[0]
    inside = np.linalg.norm(basis, axis=1) > 1e-9
    outside = np.linalg.norm(np.eye(len(basis)) - basis @ basis.T, axis=0) > 1e-9
    return np.where(
        outside, np.where(inside, IDENTIFIABLE_IN_COMBINATION, NOT_IDENTIFIABLE), IDENTIFIABLE_ALONE
    )


@pytest.mark.slow
@given(st.one_of(trees((1, 7)), trees((1, 7), bare=True)), st.booleans())
def test_the_map_is_that_of_the_row_space(tree: tb.Tree, zeros: bool) -> None:
    """A unit parameter is outside of it, has a part in it, or is in it, told by a dense basis."""
    torques, plate = (tb.minimal_set(tree, m, zeros=zeros) for m in ("torque", "wrench"))
    tared = tb.minimal_set(tree, "wrench", zeros=zeros, tared=True)
    rows = [torques.matrix, plate.matrix, tared.matrix, beside_a_pedestal(tree, tared)]
    seen = identifiability(tree, None, zeros)
    for found, told in zip(seen, rows, strict=True):
        others = told.shape[1] - 10 * tree.n
        standard = np.hstack([told[:, :others], forms_on_standard(tree, told[:, others:])])
        assert found.count == len(told)
        wanted = levels_by_orthonormal_rows(standard)[others:]
        np.testing.assert_array_equal(found.standard.ravel(), wanted)
    by_torques, by_plate, by_tared, _ = (each.standard for each in seen)
    assert (by_plate >= np.maximum(by_torques, by_tared)).all()  # it sees whatever others see
    if not zeros:
        size = np.abs(sampled_regressor(tree, "torque")).max(axis=0)
        never = levels_by_orthonormal_rows(torques.matrix) == NOT_IDENTIFIABLE
        np.testing.assert_array_equal(size < 1e-9 * max(size.max(), 1e-9), never)


# bodies before the data


def central(prior: PriorBodies, body: int) -> Array:
    """Second moments about the mass centre, (3, 3) [kg m^2]."""
    found = pseudo_inertias(prior.standard[body])
    return np.asarray(found[:3, :3] - np.outer(found[:3, 3], found[:3, 3]) / found[3, 3])


def test_bodies_before_the_data_are_the_files_or_the_nearest_that_can_be(puma: tb.Tree) -> None:
    """Possible ones as they are; points get a size, no matter stays none, no mass a usual one."""
    spread = np.diag([0.02, 0.03, 0.04])
    thick = tuple(Inertia.about_centre(2.0 + 2 * k, [0.1, 0.2, 0.3], spread) for k in range(3))
    point = Inertia.about_centre(2.0, [0.0, 0.3, 0.4], np.zeros((3, 3)))
    here = Inertia.about_centre(3.0, np.zeros(3), np.zeros((3, 3)))
    odd = Inertia(0.0, np.array([0.1, 0.0, 0.0]), np.diag([0.1, 0.2, 0.25]))
    reach = max(
        POINT_MASS_RADIUS_RATIO, *(float(np.linalg.norm(joint.offset)) for joint in puma.joints)
    )
    for bodies, masses, named in (
        (thick, [2.0, 4.0, 6.0], ()),
        ((thick[0], ZERO_INERTIA, thick[2]), [2.0, 0.0, 6.0], (1,)),
        ((thick[0], odd, thick[2]), [2.0, 4.0, 6.0], (1,)),
        ((ZERO_INERTIA,) * 3, [1.0, 1.0, 1.0], ()),
        ((point, here, thick[2]), [2.0, 3.0, 6.0], (0, 1)),
    ):
        tree = replace(puma, inertias=bodies)
        found = prior_of(tree)
        np.testing.assert_allclose(found.standard[:, 0], masses, rtol=1e-9)
        assert bool(found.diagnostics) == (bodies is not thick)
        assert all(
            any(puma.joints[k].body in each.text for each in found.diagnostics) for k in named
        )
        for k in found.massive_bodies:
            sizes = np.linalg.eigvalsh(central(found, k))
            assert sizes[0] >= 0.99 * MIN_PRIOR_MOMENT_RATIO * sizes[-1] > 0
            if bodies[k] in thick:
                np.testing.assert_allclose(found.standard[k], tb.standard(tree)[k], atol=1e-12)
    for k, away in ((0, 0.5), (1, reach)):  # a tenth of its distance, or of the robot's lengths
        radius = np.sqrt(np.trace(central(found, k)) / found.standard[k, 0])
        assert radius == pytest.approx(POINT_MASS_RADIUS_RATIO * away, rel=1e-6)
    np.testing.assert_allclose(found.standard[0, :4], [2.0, 0.0, 0.6, 0.8], atol=1e-9)


ASKED = ((ROTOR,), (OFFSET,), (OFFSET, ROTOR), JOINT_LAWS)


def drives(tree: Tree, *laws: str | JointLaw, zeros: bool | Sequence[str] = False) -> tb.DriveSet:
    """What can be told, which sampled columns confirm."""
    found = make_drive_set(tree, tb.minimal_set(tree, "torque", zeros=zeros), laws)
    assert verify_drive_set(tree, found).agrees
    return found


def turning(*axes: np.ndarray) -> Tree:
    return chain(*(("revolute", axis) for axis in axes))


@given(trees(), st.sampled_from(ASKED))
def test_sampled_columns_have_the_rank_of_the_set(tree: Tree, laws: tuple[JointLaw, ...]) -> None:
    assert verify_drive_set(tree, drives(tree, *laws)).change < 1e-11
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
    with refuses(ValueError, "wrench"):
        tb.with_joint_terms(puma, tb.minimal_set(puma, "wrench"), ["rotor"])


def test_what_tells_a_rotor_or_a_shaft_from_the_bodies_and_from_each_other() -> None:
    """By hand: weight, parallel axes, known zeros, shafts of two joints."""
    weighing = chain(("prismatic", Z))
    assert drives(weighing, "rotor").names == ("mbar1", "rotor/j1")
    names = drives(weighing, "rotor", "offset").names
    assert names == ("mbar1+rotor/j1", "offset/j1-9.81*rotor/j1")
    assert drives(turning(Z), "rotor", zeros=["K1zz"]).names == ("rotor/j1",)
    wrist, parallel = (
        with_shafts(turning(*axes), {"motor": {"j1": 1.0, "j2": 1.0}}) for axes in ((Z, Y), (Z, Z))
    )
    two = {"left": {"j1": 0.5, "j2": 0.5}, "right": {"j1": 0.5, "j2": -0.5}}
    both = with_shafts(turning(Z, Y), two)  # (a + b)^2 + (a - b)^2 = 2 a^2 + 2 b^2
    for tree, law, told in (
        (turning(Z, Z), "rotor", {"K*1zz+rotor/j1", "rotor/j2"}),
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
    motion, _ = longest_segment_motion(clean)
    speed, faster = motion.qd @ turn, motion.qdd @ turn
    rubs = (1.5 * np.sign(speed) + 0.7 * speed + 0.2 * faster)[:, None] * turn
    terms = [f"{kind}/shaft" for kind in ("coulomb", "viscous", "rotor")]
    asked = replace(EXACT, terms=terms, deadband=0.0)
    found = tb.identify(tree, plus(clean, torque=rubs), "torque", settings=asked)
    assert found.drives is not None
    truth = found.drives.values(tb.barycentric(tree), tree)
    truth = truth + found.drives.columns @ [1.5, 0.7, 0.2]
    assert np.abs(found.values - truth).max() <= 1e-8 * np.abs(truth).max()
    if "rotor/shaft" in found.names:  # else a body holds it
        np.testing.assert_allclose(joint_term_torque(motion, found), rubs, atol=1e-6)


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
