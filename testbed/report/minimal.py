"""Minimal sets, their witnesses and the identifiability map, for people and for programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from testbed.dynamics.witnesses import Agreement
from testbed.parameters.barycentric import COMPONENTS, STANDARD, parameter_names
from testbed.parameters.formulas import Lengths, latex
from testbed.parameters.identifiability import Visibility
from testbed.parameters.minimal_set import MinimalSet, selection
from testbed.parameters.rules import REASONS
from testbed.robot.tree import Tree

GLYPHS = ("·", "+", "#")
"""Never, in combination with others, alone."""


def print_sets(
    console: Console,
    tree: Tree,
    dynamic: MinimalSet,
    reaction: MinimalSet,
    seen: Sequence[Visibility],
    agreements: Sequence[Agreement],
    lengths: Lengths,
    as_latex: bool,
) -> None:
    """Both sets side by side, then what was asked for besides.

    Args:
        console: Where to print.
        tree: The robot.
        dynamic: delta_d.
        reaction: delta_r.
        seen: The identifiability map; empty for none.
        agreements: Witnesses; empty for none.
        lengths: The model's lengths as symbols or as numbers.
        as_latex: Formulas in LaTeX.
    """
    if as_latex:
        _print_latex(console, dynamic, reaction, lengths)
    else:
        console.print(minimal_table(tree, dynamic, reaction, lengths))
        for number in sorted({*dynamic.reasons, *reaction.reasons}):
            console.print(f"{number}: {REASONS[number]}", soft_wrap=True)
        lines = (*dynamic.auxiliary_with(lengths), *reaction.auxiliary_with(lengths))
        for line in dict.fromkeys(lines):
            console.print(f"with {line}", soft_wrap=True)
        for body, triad in (dynamic.triads | reaction.triads).items():
            axes = [
                f"{a} = ({x:.6g}, {y:.6g}, {z:.6g})"
                for a, (x, y, z) in zip("uvw", triad, strict=True)
            ]
            console.print(f"in body {body + 1}, {', '.join(axes)}", soft_wrap=True)
    if seen:
        console.print(map_table(tree, seen))
        legend = (
            f"{GLYPHS[2]} told alone, {GLYPHS[1]} in combination, {GLYPHS[0]} never; in the order"
        )
        console.print(f"{legend} {' '.join(STANDARD)} about the body frame")
    for each in agreements:
        console.print(_said(each), soft_wrap=True)
    lost = [name for name in reaction.never if name in dynamic.never]
    if lost and not as_latex:
        console.print(f"never told, not even in combination: {', '.join(lost)}", soft_wrap=True)
    console.print(
        f"{'% ' if as_latex else ''}{tree.name}: {10 * tree.n} parameters, "
        f"of which joint torques tell {dynamic.count} "
        f"combinations and the {'tared ' if reaction.tared else ''}bedplate {reaction.count}",
        soft_wrap=True,
    )


def minimal_table(tree: Tree, dynamic: MinimalSet, reaction: MinimalSet, lengths: Lengths) -> Table:
    """Both minimal sets side by side, each parameter with its formula and its rules."""
    table = Table(header_style="bold")
    for column in ("body", "parameter", "unit", "torques", "bedplate", "formula"):
        table.add_column(column)
    rows: dict[str, dict[str, tuple[str, str, str, str]]] = {}
    for each in (dynamic, reaction):
        formulas = each.formulas_with(lengths)
        for name, formula, unit, body, reason in zip(
            each.names, formulas, each.units, each.bodies, each.reasons, strict=True
        ):
            owner = "bedplate" if body < 0 else tree.joints[body].body
            right = formula.split(" = ", 1)[1]
            rows.setdefault(name, {})[each.model] = (owner, unit, reason, right)
    for name, models in rows.items():
        said = [models[m][3] for m in ("dynamic", "reaction") if m in models]
        right = said[0] if len(set(said)) == 1 else f"{said[0]} (bedplate: {said[1]})"
        told = [models[m][2] if m in models else "-" for m in ("dynamic", "reaction")]
        owner, unit, *_ = next(iter(models.values()))
        table.add_row(owner, name, unit, *told, "" if right == name else right)
    return table


def map_table(tree: Tree, seen: Sequence[Visibility]) -> Table:
    """A row a body, a column an instrument, ten glyphs for the ten standard parameters."""
    table = Table(header_style="bold")
    table.add_column("body")
    for each in seen:
        table.add_column(f"{each.instrument} ({each.count})")
    for j, joint in enumerate(tree.joints):
        cells = ["".join(GLYPHS[level] for level in each.standard[j]) for each in seen]
        table.add_row(joint.body, *cells)
    return table


def as_document(
    tree: Tree,
    dynamic: MinimalSet,
    reaction: MinimalSet,
    seen: Sequence[Visibility],
    agreements: Sequence[Agreement],
) -> dict[str, Any]:
    """Everything, as JSON takes it."""
    return {
        "robot": tree.name,
        "joints": list(tree.names),
        "gravity": dynamic.gravity.tolist(),
        "parameters": {"barycentric": list(parameter_names(tree)), "standard": list(STANDARD)},
        **{each.model: _set_as_json(each) for each in (dynamic, reaction)},
        "S": selection(dynamic, reaction).tolist(),
        "map": [_map_as_json(tree, each) for each in seen],
        "verified": [asdict(each) | {"holds": each.holds} for each in agreements],
    }


def _set_as_json(each: MinimalSet) -> dict[str, Any]:
    return {
        "names": list(each.names),
        "units": list(each.units),
        "formulas": list(each.formulas),
        "auxiliary": list(each.auxiliary),
        "reasons": [f"{number}: {REASONS[number]}" for number in each.reasons],
        "never": list(each.never),
        "latex": [latex(formula) for formula in each.formulas],
        "matrix": each.matrix.tolist(),
        "standard_matrix": each.standard_matrix.tolist(),
        "tared": each.tared,
    }


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


def _print_latex(
    console: Console, dynamic: MinimalSet, reaction: MinimalSet, lengths: Lengths
) -> None:
    for each in (dynamic, reaction):
        console.print(rf"% {each.model}: {each.count}")
        for formula in (*each.formulas_with(lengths), *each.auxiliary_with(lengths)):
            left, right = latex(formula).split(" = ", 1)
            line = rf"{left} &= {right} \\"
            console.print(line, soft_wrap=True)


def _said(agreement: Agreement) -> str:
    verdict = "agree" if agreement.holds else "DISAGREE"
    return (
        f"{agreement.model}: three witnesses {verdict}: rules {agreement.rules}, exact recursion "
        f"{agreement.recursion} (row spaces apart by {agreement.recursion_distance:.0e}), sampled "
        f"regressor {agreement.sampled} ({agreement.sampled_distance:.0e}, singular-value gap "
        f"{agreement.gap:.0e}); regrouping changes the model by {agreement.change:.0e}"
    )
