"""What `testbed minimal` prints: golden text, nothing cut off at any width, JSON that fits."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from rich.console import Console

import testbed as tb
from testbed.dynamics.witnesses import verify, verify_drives
from testbed.parameters.identifiability import identifiability
from testbed.parameters.joint_terms import with_joint_terms
from testbed.parameters.symbols import summands
from testbed.reporting.minimal_document import MANY, as_document, matrix_numbers
from testbed.reporting.minimal_tables import (
    Findings,
    broken_name,
    broken_sum,
    print_latex,
    print_sets,
)
from tests.helpers.paths import GOLDEN, REAL
from tests.helpers.robots import random_robot

PUMA = Path("models/puma562.urdf")
UR5 = REAL / "ur_description/urdf/ur5_robot.urdf"
HUMANOID = REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf"


def findings(tree: tb.Tree, *laws: str, zeros: bool = False, checked: bool = False) -> Findings:
    dynamic, reaction = (tb.minimal_set(tree, m, zeros=zeros) for m in ("dynamic", "reaction"))
    drives = with_joint_terms(tree, dynamic, laws) if laws else None
    if not checked:
        return Findings(tree, dynamic, reaction, drives)
    return Findings(
        tree,
        dynamic,
        reaction,
        drives,
        identifiability(tree, zeros=zeros),
        [verify(tree, each) for each in (dynamic, reaction)],
        None if drives is None else verify_drives(tree, drives),
    )


def printed(found: Findings, width: int, lengths: Literal["symbols", "numbers"] = "symbols") -> str:
    out = io.StringIO()
    print_sets(Console(file=out, width=width, markup=False, highlight=False), found, lengths)
    return out.getvalue()


def in_latex(found: Findings) -> str:
    out = io.StringIO()
    print_latex(Console(file=out, width=80, markup=False, highlight=False), found, "symbols")
    return out.getvalue()


@pytest.mark.parametrize("width", [60, 100])
def test_the_sets_of_the_puma_with_rotors(puma: tb.Tree, width: int) -> None:
    golden = (GOLDEN / f"minimal/puma562_{width}.txt").read_text(encoding="utf-8")
    assert printed(findings(puma, "rotor", "offset"), width) == golden


def test_the_sets_of_the_puma_in_latex(puma: tb.Tree) -> None:
    golden = (GOLDEN / "minimal/puma562.tex").read_text(encoding="utf-8")
    assert in_latex(findings(puma, zeros=True)) == golden


def test_latex_is_lines_and_comments_only(puma: tb.Tree) -> None:
    for line in in_latex(findings(puma, "rotor", checked=True)).splitlines():
        assert line.startswith("% ") or re.fullmatch(r"[^%]+ &= [^%]+ \\\\", line), line


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("path", [PUMA, UR5, HUMANOID], ids=lambda path: path.stem)
def test_no_name_and_no_number_is_cut_off(path: Path, width: int) -> None:
    tree = tb.load_tree(GOLDEN.parents[1] / path, weld_root=True)
    found = findings(tree, "rotor")
    text = printed(found, width)
    lines = text.splitlines()
    table = lines[: next(k for k, line in enumerate(lines) if re.match(r"\d\.\d: ", line))]
    assert max(map(len, table)) <= width
    assert "…" not in text
    dense = {re.sub(r"\s", "", line) for line in table}
    for model in ("dynamic", "reaction"):
        for formula in found.formulas(model, "symbols"):
            for part in formula.left.pieces:  # a name may go on below
                assert any(part in line for line in dense), part
            for term in formula.right if not formula.trivial else ():
                written = term.write("text").lstrip("-")
                if "(" not in written and len(written) < width // 2:
                    assert any(written.replace(" ", "") in line for line in dense), written


@pytest.mark.parametrize("seed", range(30))
def test_breaking_a_sum_loses_nothing(seed: int) -> None:
    tree = random_robot(np.random.default_rng(seed), 5).tree()
    for formula in tb.minimal_set(tree, "reaction").formulas:
        summed = summands(formula.right, "text")
        for width in (24, 40, 80):
            for lines, pieces in (
                (broken_sum(summed, width), summed),
                (broken_name(formula.left, width // 3), formula.left.pieces),
            ):
                assert "".join("".join(lines).split()) == "".join("".join(pieces).split())
                assert all(0 < len(line) <= width for line in lines)
            for piece in summed:  # a term, with its sign, stays in one line if it can
                assert len(piece) > width or any(piece in l for l in broken_sum(summed, width))


def test_verdicts_and_the_map_are_printed(puma: tb.Tree) -> None:
    text = printed(findings(puma, "rotor", checked=True), 80)
    assert "dynamic: three witnesses agree: rules 15, exact recursion 15" in text
    assert "with terms of the joints: two witnesses agree: exact recursion 16" in text
    assert "link1  ·········+  +#+····#++" in text
    assert "never told, not even in combination: mb1z, K1xx" in text
    assert "with K*2zz = K2zz + K3xx/2 + K3zz/2" in text


def test_lengths_as_numbers(puma: tb.Tree) -> None:
    assert "K2yz - 0.4318*mb3y" in printed(findings(puma), 100, "numbers")


def test_inclined_directions_are_said(puma: tb.Tree) -> None:
    tree = tb.load_tree(GOLDEN.parents[1] / PUMA)
    reaction = tb.minimal_set(tree, "reaction", (0.0, 6.0, -8.0))
    dynamic = tb.minimal_set(tree, "dynamic", (0.0, 6.0, -8.0))
    text = printed(Findings(tree, dynamic, reaction), 100)
    assert "in the bedplate, u = (" in text
    assert "w = (0, 0.6, -0.8)" in text


# for programs


def test_the_document_of_a_small_robot_has_its_matrices(puma: tb.Tree) -> None:
    found = findings(puma, "rotor", "coulomb", zeros=True, checked=True)
    document = json.loads(json.dumps(as_document(found)))
    for each in (found.dynamic, found.reaction):
        written = document[each.model]
        np.testing.assert_array_equal(written["matrix"], each.matrix)
        np.testing.assert_array_equal(written["standard_matrix"], each.standard_matrix)
        assert written["names"] == list(each.names)
        assert len(written["known_zero"]) == 9
    np.testing.assert_array_equal(document["S"], np.eye(9, 12))
    drives = document["drives"]
    assert drives["own"] == ["rotor/elbow", "coulomb/waist", "coulomb/shoulder", "coulomb/elbow"]
    assert drives["regrouped"] == {
        "rotor/waist": {"K*1zz+rotor/waist": 1.0},
        "rotor/shoulder": {"K*2yy+rotor/shoulder": 1.0},
    }
    assert drives["verified"]["holds"]
    assert all(each["holds"] for each in document["verified"])


def test_matrices_can_be_left_out(puma: tb.Tree) -> None:
    """Those on the standard parameters, which nothing else needs, are not even made."""
    found = findings(puma, "rotor")
    document = as_document(found, matrices=False)
    assert "standard_matrix" not in vars(found.dynamic)
    assert "S" not in document
    assert "matrix" not in document["dynamic"]
    assert "columns" not in document["drives"]
    assert document["dynamic"]["formulas"]


def test_what_is_said_of_the_size_is_what_is_written(puma: tb.Tree) -> None:
    found = findings(puma, "rotor")
    document = as_document(found)
    arrays = [document["S"], document["drives"]["columns"]]
    for model in ("dynamic", "reaction"):
        arrays += [document[model]["matrix"], document[model]["standard_matrix"]]
    assert matrix_numbers(found) == sum(np.size(each) for each in arrays)
    small = random_robot(np.random.default_rng(0), 30).tree()
    large = random_robot(np.random.default_rng(0), 120).tree()
    assert matrix_numbers(findings(small)) < MANY < matrix_numbers(findings(large))
