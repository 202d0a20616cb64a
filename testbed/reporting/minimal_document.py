"""Minimal sets as one document for programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from testbed.parameters.barycentric import COMPONENTS, STANDARD, parameter_names
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet, selection
from testbed.parameters.rules import REASONS
from testbed.reporting.minimal_tables import Findings
from testbed.robot.tree import Tree

if TYPE_CHECKING:
    from testbed.parameters.identifiability import Visibility


MANY = 500_000
"""Numbers in the matrices above which they are left out unless they are asked for."""

BYTES = 8
"""About what one number of a matrix takes in the document."""


def matrix_numbers(found: Findings) -> int:
    """How many numbers the matrices hold; it grows with the square of the joints."""
    d, r, columns = found.dynamic.count, found.reaction.count, 10 * found.tree.n
    drives = 0 if found.drives is None else found.drives.count * len(found.drives.asked)
    return 2 * (d + r) * columns + d * r + drives


def as_document(found: Findings, matrices: bool = True) -> dict[str, Any]:
    """Everything, as JSON takes it.

    Args:
        found: What is known about the robot.
        matrices: Whether to write the sets as matrices, too.
    """
    sets = (found.dynamic, found.reaction)
    document: dict[str, Any] = {
        "robot": found.tree.name,
        "joints": list(found.tree.names),
        "gravity": found.dynamic.gravity.tolist(),
        "parameters": {
            "barycentric": list(parameter_names(found.tree)),
            "standard": list(STANDARD),
        },
        **{each.model: _set_as_json(found.tree, each, matrices) for each in sets},
        "map": [_map_as_json(found.tree, each) for each in found.seen],
        "verified": [asdict(each) | {"holds": each.holds} for each in found.agreements],
    }
    if matrices:
        document["S"] = selection(*sets).tolist()
    if found.drives is not None:
        document["drives"] = _drives_as_json(found.drives, matrices)
    if (agree := found.drives_agree) is not None:
        document["drives"]["verified"] = asdict(agree) | {"holds": agree.holds}
    return document


def _set_as_json(tree: Tree, each: MinimalSet, matrices: bool) -> dict[str, Any]:
    whole = {}
    if matrices:
        whole["matrix"] = each.matrix.tolist()
        whole["standard_matrix"] = each.standard_matrix.tolist()
    return whole | {
        "names": list(each.names),
        "units": list(each.units),
        "formulas": [str(formula) for formula in each.formulas],
        "auxiliary": [str(formula) for formula in each.auxiliary],
        "reasons": [f"{number}: {REASONS[number]}" for number in each.reasons],
        "never": list(each.never),
        "latex": [formula.latex() for formula in each.formulas],
        "tared": each.tared,
        "known_zero": [
            name
            for name, zero in zip(parameter_names(tree), each.known_zero.ravel(), strict=True)
            if zero
        ],
    }


def _drives_as_json(drives: DriveSet, matrices: bool) -> dict[str, Any]:
    asked = [drives.symbol(term).text for term in drives.asked]
    regrouped = {
        drives.symbol(term).text: {
            name: float(share) for name, share in zip(drives.names, column, strict=True) if share
        }
        for term, column in drives.regrouped.items()
    }
    return {
        "names": list(drives.names),
        "units": list(drives.units),
        "formulas": [str(formula) for formula in drives.formulas],
        "latex": [formula.latex() for formula in drives.formulas],
        "asked": asked,
        "own": [drives.symbol(term).text for term in drives.terms],
        "regrouped": regrouped,
    } | ({"columns": drives.columns.tolist()} if matrices else {})


def _map_as_json(tree: Tree, each: Visibility) -> dict[str, Any]:
    words = ("never", "combined", "alone")
    levels = {"standard": (STANDARD, each.standard), "barycentric": (COMPONENTS, each.barycentric)}
    return {"instrument": each.instrument, "count": each.count} | {
        basis: {
            joint.body: {p: words[level] for p, level in zip(names, table[j], strict=True)}
            for j, joint in enumerate(tree.joints)
        }
        for basis, (names, table) in levels.items()
    }
