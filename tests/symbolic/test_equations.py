"""Generated equations: the paper's listing term by term, and code against Pinocchio."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExpressionError, UnknownName
from testbed.symbolic.angles import right_angles
from testbed.symbolic.compare import compare_equations
from testbed.symbolic.equations import FORMS, Form, Listing, equations
from testbed.symbolic.expression import Expression, expression
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.languages import as_document, write_equations
from testbed.symbolic.parse import read_listing, wave
from testbed.symbolic.polynomial import same
from tests.helpers.cases import cases
from tests.helpers.generated import c_call, c_library, python_module
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.pinocchio import by_pinocchio
from tests.helpers.robots import Robot, random_robot, random_states

pytestmark = pytest.mark.slow

ROBOTS = sorted((GOLDEN / "robots").glob("*.urdf"), key=lambda path: (path.stat().st_size, path))
LONG = ("humanoid_pelvis", "kuka_lwr4")
"""All kinds of their literal forms take minutes to write and compile."""
SECTIONS = dict(
    re.findall(r"\[(\w+)\]\n(.*?)(?=\n\[|\Z)", (GOLDEN / "equations.txt").read_text(), re.DOTALL)
)
AGREES = 1e-12


def check(listing: Listing, urdf: str, tree: tb.Tree, folder: Path, seed: int = 0) -> None:
    """Python and C of all kinds against Pinocchio."""
    states = random_states(np.random.default_rng(seed), 4, tree.n)
    truth = by_pinocchio(urdf, tree, states)
    expected = {
        "joint-forces": truth.forces,
        "dynamic-regressor": truth.forces,
        "base-wrench": truth.wrench,
        "reaction-regressor": truth.wrench,
        "mass-matrix": truth.mass,
        "gravity-forces": truth.gravity,
    }
    module = python_module(write_equations(listing, "python"), folder)
    library = c_library(write_equations(listing, "c"), folder, "-O0")
    theta = tb.barycentric(tree)
    for each in listing.equations:
        full = listing.form == "full"
        vector = theta.ravel() if full else listing.minimal[each.kind.model].values(theta)
        name = each.kind.name.replace("-", "_")
        inputs = list(states[: len(each.kind.takes)])
        given = [] if each.kind.is_regressor else [vector]
        result = getattr(module, name)(*inputs, *given)
        in_c = np.array(
            [
                c_call(library, name, [*sample, *given], each.shape)
                for sample in zip(*inputs, strict=True)
            ]
        )
        for found in (result, in_c):
            product = found @ vector if each.kind.is_regressor else found
            scale = max(1.0, np.abs(expected[each.kind.name]).max())
            assert product.shape == expected[each.kind.name].shape
            assert np.abs(product - expected[each.kind.name]).max() <= AGREES * scale, (
                each.kind.name
            )


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("path", cases(ROBOTS, fast=3), ids=lambda p: p.stem)
def test_generated_code_agrees_with_pinocchio(path: Path, form: Form, tmp_path: Path) -> None:
    tree = tb.load_tree(path)
    short = form == "recursive" or path.stem not in LONG
    kinds = list(KINDS) if short else ["joint-forces", "gravity-forces"]
    check(equations(tree, kinds, form), path.read_text(), tree, tmp_path)


@pytest.mark.parametrize("seed", cases(range(20), fast=2))
def test_random_trees_agree_with_pinocchio(seed: int, tmp_path: Path) -> None:
    """Branches, sliding joints, inclined axes, any gravity; lengths as symbols and as numbers."""
    rng = np.random.default_rng(seed)
    form = FORMS[seed % 3]
    n = int(rng.integers(1, 9 if form == "recursive" else 5))
    robot: Robot = random_robot(rng, n, gravity=rng.normal(size=3) * 6 * (seed % 4 > 0))
    tree = robot.tree()
    listing = equations(tree, list(KINDS), form, numbers=seed % 2 == 1)
    check(listing, robot.urdf(), tree, tmp_path, seed)


@pytest.mark.slow
def test_known_zeros_are_left_out_and_the_rest_agrees(tmp_path: Path) -> None:
    path = ROOT / "models/puma562.urdf"
    tree = tb.load_tree(path)
    for form in FORMS:
        listing = equations(tree, list(KINDS), form, zeros=True)
        (tmp_path / form).mkdir()  # a library is loaded once from one path
        check(listing, path.read_text(), tree, tmp_path / form)
        assert not re.search(r"\b(mbs?\dx|Ks?\dx[yz])", write_equations(listing, "paper"))


def golden(section: str, names: dict[str, Expression]) -> dict[str, Expression]:
    text = re.sub(r"^#.*\n", "", SECTIONS[section], flags=re.MULTILINE)
    return read_listing(text, names)


def symbols(listing: Listing) -> dict[str, Expression]:
    """By name, everything that a listing's equations and definitions are written with."""
    values = [value for each in listing.equations for _, value in each.program.lines]
    values += [value for _, value in listing.definitions]
    found = {}
    todo = [factor for value in values for factors, _ in value.terms for factor in factors]
    while todo:
        factor = todo.pop()
        if factor.content is not None:
            todo += [f for factors, _ in factor.content.terms for f in factors]
        else:
            found[factor.name.replace("mbar", "mm")] = Expression((((factor,), 1),))
    return found


@pytest.mark.parametrize("form", ["full", "reduced"])
def test_the_papers_listing_term_by_term(form: Form, puma: tb.Tree) -> None:
    """[FRS96] 3.3 and 6.1: Q1, Q2, Q3 with their products of sines and cosines."""
    listing = equations(puma, ["joint-forces"], form, zeros=True)
    names = symbols(listing)
    printed = golden(f"{form}_table1", {n: v for n, v in names.items() if n[0] != "Q"})
    ours = {name.name: value for name, value in listing.equations[0].program.steps}
    assert list(ours) == ["Q3", "Q2", "Q1"]
    assert ours["Q3"] == printed["Q3"]
    assert ours["Q1"] == printed["Q1"]
    (second,) = [v for f, v in ours["Q2"].terms if f[0].name == "Q3"]
    assert second == 1
    assert ours["Q2"] - names["Q3"] == printed["Q2"] - printed["Q3"]
    assert len(printed["Q1"].terms) == {"full": 23, "reduced": 16}[form]


def test_the_reaction_is_the_golden_one(puma: tb.Tree) -> None:
    """In body 1's axes there, in the bedplate's here."""
    listing = equations(puma, ["base-wrench"], "reduced", zeros=True)
    names = symbols(listing)
    printed = golden("reaction_table1", names)
    ours = {name.name: value for name, value in listing.equations[0].program.steps}
    c, s = wave("C1", names), wave("S1", names)
    for here, there in (("F", "F1"), ("M", "L1")):
        x, y, z = (printed[f"{there}{axis}"] for axis in "xyz")
        assert same(ours[f"{here}x"], expression(c * x) - expression(s * y))
        assert same(ours[f"{here}y"], expression(s * x) + expression(c * y))
        assert same(ours[f"{here}z"], z)


def test_the_definitions_are_the_golden_ones(puma: tb.Tree) -> None:
    listing = equations(puma, ["joint-forces"], "full", zeros=True)
    names = symbols(listing)
    printed = golden("barycentric_table1", names)
    ours = {name.replace("mbar", "mm"): value for name, value in listing.definitions}
    assert set(ours) == set(printed)
    for name, value in ours.items():
        assert same(value, printed[name]), name


@pytest.mark.parametrize("form", ["full", "reduced"])
def test_the_tool_agrees_with_the_golden_listing(form: Form, puma: tb.Tree) -> None:
    text = re.sub(r"^#.*\n", "", SECTIONS[f"{form}_table1"], flags=re.MULTILINE)
    found = compare_equations(puma, text, form, zeros=True)
    assert set(found) == {"Q1", "Q2", "Q3"}
    assert not any(found.values())


def test_the_printed_reduced_equation_lacks_a_factor_of_two(puma: tb.Tree) -> None:
    """With the sign that Table 6 gives K_d, only the three velocity terms differ."""
    listings = ROOT / "docs/listings"
    printed, turned = (listings / f"paper_reduced{end}.txt" for end in ("", "_sign"))
    as_printed = compare_equations(puma, printed.read_text(), "reduced", zeros=True)["Q1"]
    assert len(as_printed.terms) == 5
    difference = compare_equations(puma, turned.read_text(), "reduced", zeros=True)["Q1"]
    halves = read_listing(
        "D = - Ks2d*qp1*qp2*S22 - K3d*qp1*qp2*S2233 - K3d*qp1*qp3*S2233",
        symbols(equations(puma, ["joint-forces"], "reduced", zeros=True)),
    )["D"]
    assert difference == halves


def test_a_planar_arm_by_hand(tmp_path: Path) -> None:
    """Two links in a vertical plane: every textbook's equation."""
    (tmp_path / "two.urdf").write_text(
        '<robot name="two"><link name="a"/>'
        + "".join(
            f'<link name="{b}"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{b}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
            f'<origin xyz="{x} 0 0" rpy="0 0 0"/><axis xyz="0 -1 0"/>'
            '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
            for a, b, x in (("a", "b", 0), ("b", "c", 0.5))
        )
        + "</robot>"
    )
    tree = tb.load_tree(tmp_path / "two.urdf")
    text = (
        "Q2 = K2yy*qpp1 + K2yy*qpp2 + mb2x*l12x*C2*qpp1 + mb2x*l12x*S2*qp1*qp1 + mb2x*g*C12\n"
        "Q1 = Q2 + K1yy*qpp1 + mb1x*g*C1 + mb2x*l12x*(C2*(qpp1 + qpp2)"
        " - S2*(qp1 + qp2)*(qp1 + qp2))\n"
    )
    assert not any(compare_equations(tree, text, "full", zeros=True).values())
    wrong = compare_equations(tree, text.replace("C12", "C2"), "full", zeros=True)
    assert all(wrong.values())


@pytest.mark.parametrize("kind", KINDS)
def test_results_are_called_by_their_row(kind: str, puma: tb.Tree) -> None:
    """Q1 to Q3 of three joints, F and M of the plate, as their places in the array say."""
    (found,) = equations(puma, kind, zeros=True).equations
    rows = ["FM"[k // 3] + "xyz"[k % 3] for k in range(6)]
    if KINDS[kind].model == "dynamic":
        rows = [f"{j + 1}" for j in range(3)]
    assert {at[0] for at in found.places.values()} == set(range(len(rows)))
    for name, at in found.places.items():
        assert re.fullmatch(KINDS[kind].results, name.name)
        assert re.match(rf"(phi_)?[QGM]?{rows[at[0]]}", name.name), (name, at)


def test_latex_is_well_formed(puma: tb.Tree) -> None:
    for form in FORMS:
        text = write_equations(equations(puma, list(KINDS), form), "latex")
        body = re.sub(r"%.*", "", text)
        assert body.count("{") == body.count("}")
        assert body.count(r"\begin{align*}") == body.count(r"\end{align*}") == len(KINDS) + 1
        assert not re.search(r"(?<![\\{])_(?!\{)", body.replace(r"\_", ""))
        for line in body.splitlines():
            assert line.count("&") <= 1, line


@pytest.mark.slow
def test_the_same_bits_in_every_process() -> None:
    """Nothing depends on the order of hashes."""
    code = (
        "import testbed as tb\n"
        "from testbed.symbolic.equations import equations\n"
        "from testbed.symbolic.languages import write_equations\n"
        f"tree = tb.load_tree({str(GOLDEN / 'robots/puma560_6.urdf')!r})\n"
        "for form in ('recursive', 'reduced'):\n"
        "    print(write_equations(equations(tree, ['dynamic-regressor'], form), 'python'))\n"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
            text=True,
            cwd=ROOT,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(texts) == 1


def test_python_takes_samples_of_any_shape_and_refuses_others(
    puma: tb.Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = python_module(
        write_equations(equations(puma, ["joint-forces"], "recursive"), "python"), tmp_path
    )
    delta = np.linspace(0.1, 1.5, 15)
    q, qd, qdd = random_states(np.random.default_rng(1), 10_000, 3)
    whole = module.joint_forces(q, qd, qdd, delta)
    assert module.joint_forces(q[5], qd[5], qdd[5], delta).shape == (3,)
    cube = [x.reshape(10, 1000, 3) for x in (q, qd, qdd)]
    np.testing.assert_array_equal(module.joint_forces(*cube, delta).reshape(-1, 3), whole)
    monkeypatch.setattr(module, "BLOCK", 7)
    np.testing.assert_allclose(
        module.joint_forces(q, qd, qdd, delta), whole, rtol=1e-14, atol=1e-13
    )
    with pytest.raises(ValueError, match="one joint a column"):
        module.joint_forces(q[:, :2], qd, qdd, delta)
    with pytest.raises(ValueError, match="15 parameters, found 9"):
        module.joint_forces(q, qd, qdd, delta[:9])


def test_almost_right_angles(tmp_path: Path) -> None:
    text = (GOLDEN / "robots/puma560_6.urdf").read_text()
    (tmp_path / "r.urdf").write_text(text.replace("1.570796326794897", "1.57083"))
    crooked, right = (
        tb.load_tree(p) for p in (tmp_path / "r.urdf", GOLDEN / "robots/puma560_6.urdf")
    )
    as_read = equations(crooked, ["joint-forces"], "recursive")
    assert "j2 is 3e-05 rad off a right angle" in write_equations(as_read, "paper")
    squared = write_equations(
        equations(right_angles(crooked), ["joint-forces"], "recursive"), "paper"
    )
    assert squared == write_equations(equations(right, ["joint-forces"], "recursive"), "paper")
    assert "off a right angle" not in squared


def test_what_cannot_be_written_is_refused(puma: tb.Tree) -> None:
    with pytest.raises(UnknownName, match="did you mean 'joint-forces'"):
        equations(puma, ["joint-force"])
    with pytest.raises(UnknownName, match="unknown form 'long'"):
        equations(puma, form="long")  # type: ignore[arg-type]
    with pytest.raises(UnknownName, match="unknown language 'fortran'"):
        write_equations(equations(puma), "fortran")  # type: ignore[arg-type]
    with pytest.raises(UnknownName, match="unknown equation 'K9'"):
        compare_equations(puma, "K9 = 0", "full")


@pytest.mark.parametrize("form", ["full", "reduced"])
@pytest.mark.parametrize(
    "name", ["puma560_3", "gantry_ppp_rrr", "t2_rp_inclined_v", "t4_rr_inclined", "two_trunks"]
)
def test_its_own_listings_read_back_as_equal(name: str, form: Form) -> None:
    """To the last digit, oblique axes included; definitions of the full form as well."""
    tree = tb.load_tree(GOLDEN / f"robots/{name}.urdf")
    kinds = ["joint-forces", "base-wrench", "mass-matrix", "gravity-forces"]
    text = write_equations(equations(tree, kinds, form), "paper")
    found = compare_equations(tree, text, form)
    assert set(found) >= {"Q1", "Fz", "M11", "G2"}
    assert not any(found.values())


@pytest.mark.parametrize("seed", cases(range(12), fast=2))
def test_recursive_listings_are_complete(seed: int) -> None:
    """No line uses what no line defines; read as text, they are the literal equations."""
    rng = np.random.default_rng(100 + seed)
    tree = random_robot(rng, 4, gravity=(0, 0, -9.81)).tree()
    kinds = ["joint-forces", "base-wrench", "mass-matrix", "gravity-forces"]
    text = write_equations(equations(tree, kinds, "recursive"), "paper")
    for part in text.split("\n* ")[1:]:  # auxiliary variables are each kind's own
        body = part.partition("\n")[2]
        if re.search(r"^\w+ =", body, re.MULTILINE):
            assert not any(compare_equations(tree, body, "recursive").values())


def test_what_a_listing_may_not_say(puma: tb.Tree) -> None:
    own = write_equations(equations(puma, form="reduced", zeros=True), "paper")
    with pytest.raises(UnknownName, match="unknown equation 'Q4'"):
        compare_equations(puma, own.replace("Q2", "Q4"), "reduced", zeros=True)
    with pytest.raises(ExpressionError, match="'q1' is the robot's own"):
        compare_equations(puma, "q1 = 0\nQ1 = q1", "reduced", zeros=True)
    with pytest.raises(ExpressionError, match="holds no equation"):
        compare_equations(puma, "# nothing", "reduced", zeros=True)
    with pytest.raises(UnknownName, match="unknown form 'short'"):
        compare_equations(puma, own, "short")  # type: ignore[arg-type]


def test_one_kind_and_one_zero_may_be_plain_words(puma: tb.Tree) -> None:
    listing = equations(puma, "mass-matrix", "reduced", zeros="mb3x")
    assert [each.kind.name for each in listing.equations] == ["mass-matrix"]
    assert listing.known_zero.sum() == 1


def test_a_document_for_programs(puma: tb.Tree) -> None:
    listing = equations(puma, ["joint-forces"], "reduced", zeros=True)
    document = as_document(listing, write_equations(listing, "paper"))
    assert document["equations"]["joint-forces"]["shape"] == (3,)
    assert document["equations"]["joint-forces"]["operations"]["trigonometric"] == 11
    assert document["equations"]["joint-forces"]["delta_d"][2] == {
        "name": "2*K3d",
        "unit": "kg m^2",
    }
    assert document["constants"] == pytest.approx({"l12z": 0.6718, "l23z": 0.4318, "g": 9.81})
