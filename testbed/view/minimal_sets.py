"""Minimal sets: on the terminal with map and witnesses, in LaTeX, and as JSON for programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from testbed.core.base.errors import plural
from testbed.core.dynamics.rank_check import Agreement, DriveAgreement
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet, selection
from testbed.core.parameters.regroup import Lengths
from testbed.core.parameters.rules import REASONS
from testbed.core.parameters.symbols import STANDARD, Formula, parameter_names
from testbed.core.robot.shafts import places
from testbed.core.robot.tree import Tree

if TYPE_CHECKING:
    from testbed.core.parameters.identifiability import Visibility


GLYPHS = ("·", "+", "#")
"""Never, in combination with others, alone."""

GAP = 2
"""Blanks between columns."""

WIDTHS = (6, 7, 8)
"""Widths of the columns between name and formula: unit, torques, plate."""

SENSORS = {
    "torques": "joint torques",
    "plate": "the force plate",
    "sensor": "the force sensor",
}
"""Names of sensors in a sentence."""

SHARE = 3
"""A name takes no more than one part of so many of a line, and goes on below."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What is known about a robot before any data.

    Attributes:
        tree: The robot.
        dynamic: delta_d.
        reaction: delta_r.
        drives: The dynamic set together with terms of the joints; None if none are asked for.
        seen: The identifiability map; empty for none.
        agreements: Witnesses of the sets and of the drives; empty for none.
    """

    tree: Tree
    dynamic: MinimalSet
    reaction: MinimalSet
    drives: DriveSet | None = None
    seen: Sequence[Visibility] = ()
    agreements: Sequence[Agreement | DriveAgreement] = ()

    @property
    def by_sensor(self) -> dict[str, MinimalSet]:
        """Sets by the sensor's name; a force sensor in the robot is the only one."""
        if self.tree.sensor is not None:
            return {"sensor": self.reaction}
        return {"torques": self.dynamic, "plate": self.reaction}

    @property
    def sets(self) -> tuple[MinimalSet, ...]:
        """Sets of the robot's sensors."""
        return tuple(self.by_sensor.values())

    @property
    def hold(self) -> bool:
        """Whether all witnesses agree."""
        return all(each.holds for each in self.agreements)

    def formulas(self, minimal: MinimalSet, lengths: Lengths) -> tuple[Formula, ...]:
        """Formulas of one set's parameters, with the terms regrouped into them."""
        if minimal.model == "reaction" or self.drives is None:
            return minimal.formulas_with(lengths)
        return self.drives.formulas_with(lengths)[: minimal.count]


def print_sets(console: Console, found: Findings, lengths: Lengths) -> None:
    """Both sets side by side, body by body, then what was asked for besides.

    Args:
        console: Where to print; nothing is cut off at its width.
        found: What to print.
        lengths: The model's lengths as symbols or as numbers.
    """
    _print_bodies(console, found, lengths)
    for line in _explained(found, lengths):
        console.print(line)
    if found.seen:
        console.print(map_table(found.tree, found.seen))
        console.print(
            f"{GLYPHS[2]} identifiable alone, {GLYPHS[1]} in combination, {GLYPHS[0]} not"
            f"{' or fixed to zero' * bool(found.dynamic.known_zero.any())}; in the "
            f"order {' '.join(STANDARD)} about the body frame"
        )
    for line in _verdicts(found):
        console.print(line)
    beyond = parameter_names(found.tree)[10 * found.tree.massless :]
    never = set.intersection(*(set(each.never) for each in found.sets))
    if lost := [name for name in beyond if name in never]:
        console.print(f"not identifiable, not even in combination: {', '.join(lost)}")
    console.print(_summary(found))


def print_latex(console: Console, found: Findings, lengths: Lengths) -> None:
    """The formulas as lines of an aligned display.

    Args:
        console: Where to print.
        found: What to print.
        lengths: The model's lengths as symbols or as numbers.
    """
    for each in found.sets:
        console.print(f"% {each.model}: {each.count}")
        for formula in (*found.formulas(each, lengths), *each.auxiliary_with(lengths)):
            console.print(rf"{formula.latex('&=')} \\")
    for line in _verdicts(found):
        console.print(f"% {line}")
    console.print(f"% {_summary(found)}")


def map_table(tree: Tree, seen: Sequence[Visibility]) -> Table:
    """A row a body, a column an instrument, ten glyphs for the ten standard parameters."""
    table = Table(box=None, padding=(0, GAP, 0, 0), header_style="bold")
    table.add_column("body", overflow="fold")
    for each in seen:
        sensor = {"tared bedplate": "plate, tared"}.get(
            each.instrument, each.instrument
        )
        sensor = sensor.replace("bedplate", "plate")
        table.add_column(f"{sensor} ({each.count})", width=len(STANDARD))
    for j, joint in list(enumerate(tree.joints))[tree.massless :]:
        cells = ["".join(GLYPHS[level] for level in each.standard[j]) for each in seen]
        table.add_row(joint.body, *cells)
    return table


def _print_bodies(console: Console, found: Findings, lengths: Lengths) -> None:
    """Body by body, tips first and the bedplate last: parameters, and the rules that keep them."""
    rows = _rows(found, lengths)
    names = [formula.left.text for known in rows.values() for formula in known]
    width = min(max(map(len, names), default=0), console.width // SHARE)
    for body in sorted(rows, reverse=True):
        console.print(_heading(found, body), style="bold")
        table = Table(box=None, padding=(0, 0, 0, GAP), header_style="bold")
        table.add_column(
            "parameter", width=max(width, len("parameter")), overflow="fold"
        )
        table.show_header = body == max(rows)
        for head, wide in zip(("unit", *found.by_sensor), WIDTHS, strict=False):
            table.add_column(head, min_width=wide)
        table.add_column("combination of", overflow="fold")
        for formula, row in rows[body].items():
            rules = (row.get(sensor, "-") for sensor in ("unit", *found.by_sensor))
            table.add_row(
                formula.left.text, *rules, "" if formula.trivial else formula.said
            )
        console.print(table)


def _rows(
    found: Findings, lengths: Lengths
) -> dict[int, dict[Formula, dict[str, str]]]:
    """By body and formula: the unit, and the rule that keeps it by sensor."""
    rows: dict[int, dict[Formula, dict[str, str]]] = {}
    for sensor, each in found.by_sensor.items():
        formulas = found.formulas(each, lengths)
        columns = zip(each.bodies, formulas, each.units, each.reasons, strict=True)
        for body, formula, unit, reason in columns:
            row = rows.setdefault(body, {}).setdefault(formula, {"unit": unit})
            row[sensor] = reason
    return rows


def _heading(found: Findings, body: int) -> str:
    if body < 0:
        return "the bedplate"
    joint = found.tree.joints[body]
    kind = "revolute" if joint.revolute else "prismatic"
    carrier = (
        found.tree.joints[joint.parent].body if joint.parent >= 0 else "the bedplate"
    )
    return f"{body + 1}  {joint.body}, {kind} on {carrier}"


def _explained(found: Findings, lengths: Lengths) -> Iterator[str]:
    """Rules, redefinitions, directions and terms of the joints, a line each."""
    for number in sorted({reason for each in found.sets for reason in each.reasons}):
        yield f"{'rule ' * number[0].isdigit()}{number}: {REASONS[number]}"
    sensors: dict[Formula, list[str]] = {}
    for sensor, each in found.by_sensor.items():
        for formula in each.auxiliary_with(lengths):
            sensors.setdefault(formula, []).append(sensor)
    for formula, names in sensors.items():
        yield f"with {formula}{f' ({names[0]})' if len(names) < len(found.sets) else ''}"
    for body, triad in (found.sets[0].triads | found.reaction.triads).items():
        axes = (
            f"{letter} = ({x:.6g}, {y:.6g}, {z:.6g})"
            for letter, (x, y, z) in zip(triad.letters, triad.axes, strict=True)
        )
        yield f"in {f'body {body + 1}' if body >= 0 else 'the bedplate'}, {', '.join(axes)}"
    if found.drives is not None:
        yield from _drive_lines(found.drives, found.tree)


def _drive_lines(drives: DriveSet, tree: Tree) -> Iterator[str]:
    """Which terms of the joints have columns of their own, and where the others are."""
    names = places(tree)
    for law in dict.fromkeys(term.law for term in drives.asked):
        joints = [names[term.joint] for term in drives.terms if term.law == law]
        if joints:
            yield f"{law.kind}: a column of its own for {', '.join(joints)}"
    for term, column in drives.regrouped.items():
        holders = [
            name for name, share in zip(drives.names, column, strict=True) if share
        ]
        beside = " and ".join(holders)
        yield f"{drives.symbol(term).text}: identifiable only in combination with {beside}"


def _summary(found: Findings) -> str:
    (first, *others), (count, *counts) = (
        found.by_sensor,
        [each.count for each in found.sets],
    )
    phrase = f"{plural(count, 'combination')} identifiable by {SENSORS[first]}"
    for sensor, count in zip(others, counts, strict=True):
        phrase += f", {count} by {SENSORS[sensor]}"
    phrase += " (tared)" * found.reaction.tared
    if found.drives is not None:
        phrase += f"; with terms of the joints, {plural(found.drives.count, 'unknown')}"
    bodies = found.tree.n - found.tree.massless
    return f"{found.tree.name}: {10 * bodies} parameters; {phrase}"


def _verdicts(found: Findings) -> Iterator[str]:
    """What the witnesses say, a line each."""
    for each in found.agreements:
        agree = "agree" if each.holds else "DISAGREE"
        change = f"regrouping changes the model by {each.change:.0e}"
        if isinstance(each, Agreement):
            yield (
                f"{each.model}: three methods {agree}: rules {each.rules}, exact recursion "
                f"{each.recursion} (row spaces apart by {each.recursion_distance:.0e}), sampled "
                f"regressor {each.sampled} ({each.sampled_distance:.0e}, singular-value gap "
                f"{each.gap:.0e}); {change}"
            )
        else:
            yield (
                f"with terms of the joints: two methods {agree}: exact recursion {each.count}, "
                f"sampled columns {each.sampled} (singular-value gap {each.gap:.0e}); {change}"
            )


def as_document(found: Findings, matrices: bool = True) -> dict[str, Any]:
    """Everything, as JSON takes it.

    Args:
        found: What is known about the robot.
        matrices: Whether to write the sets as matrices, too.
    """
    sets = found.sets
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
    if matrices and len(sets) > 1:
        document["S"] = selection(*sets).tolist()
    if found.drives is not None:
        document["drives"] = _drives_as_json(found.drives, matrices)
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
            for name, zero in zip(
                parameter_names(tree), each.known_zero.ravel(), strict=True
            )
            if zero
        ],
    }


def _drives_as_json(drives: DriveSet, matrices: bool) -> dict[str, Any]:
    asked = [drives.symbol(term).text for term in drives.asked]
    regrouped = {
        drives.symbol(term).text: {
            name: float(share)
            for name, share in zip(drives.names, column, strict=True)
            if share
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
    bodies = {
        joint.body: dict(zip(STANDARD, map(words.__getitem__, levels), strict=True))
        for joint, levels in zip(tree.joints, each.standard.tolist(), strict=True)
    }
    return {"instrument": each.instrument, "count": each.count, "standard": bodies}
