"""Minimal sets: on the terminal with map and witnesses, in LaTeX, and as JSON for programs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from testbed.core.base.errors import plural
from testbed.core.dynamics.drive_set import Agreement, DriveAgreement
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet, selection
from testbed.core.parameters.regroup import Lengths
from testbed.core.parameters.rules import REASONS, Model
from testbed.core.parameters.symbols import (
    COMPONENTS,
    STANDARD,
    Formula,
    Label,
    parameter_names,
    summands,
)
from testbed.core.robot.locks import places
from testbed.core.robot.tree import Tree

if TYPE_CHECKING:
    from testbed.core.parameters.identifiability import Visibility


MANY = 500_000
"""Numbers in the matrices above which they are left out unless they are asked for."""

BYTES = 8
"""About what one number of a matrix takes in the document."""

GLYPHS = ("·", "+", "#")
"""Never, in combination with others, alone."""

HEADINGS = {"unit": 6, "torques": 7, "plate": 8}
"""Of the columns between name and formula, and their widths."""

NAME = "parameter"
"""Heading of the names."""

GAP = 2
"""Blanks between columns."""

LEAST = 24
"""Columns below which a formula goes below its parameter."""

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
        agreements: Witnesses; empty for none.
        drives_agree: The witness of the drives; None for none.
    """

    tree: Tree
    dynamic: MinimalSet
    reaction: MinimalSet
    drives: DriveSet | None = None
    seen: Sequence[Visibility] = ()
    agreements: Sequence[Agreement] = ()
    drives_agree: DriveAgreement | None = None

    @property
    def sets(self) -> tuple[MinimalSet, ...]:
        """Those of the robot's instruments: a force sensor in the robot is the only one."""
        return (self.dynamic, self.reaction) if self.tree.sensor is None else (self.reaction,)

    @property
    def hold(self) -> bool:
        """Whether all witnesses agree."""
        drives = self.drives_agree is None or self.drives_agree.holds
        return drives and all(each.holds for each in self.agreements)

    def formulas(self, model: Model, lengths: Lengths) -> tuple[Formula, ...]:
        """Of one model's minimal parameters, with the terms regrouped into them."""
        if model == "reaction":
            return self.reaction.formulas_with(lengths)
        if self.drives is None:
            return self.dynamic.formulas_with(lengths)
        return self.drives.formulas_with(lengths)[: self.dynamic.count]


@dataclass(frozen=True)
class _Line:
    """One parameter: its formula, unit, and the rule that keeps it by model."""

    formula: Formula
    unit: str
    torques: str = "-"
    bedplate: str = "-"


def print_sets(console: Console, found: Findings, lengths: Lengths) -> None:
    """Both sets side by side, body by body, then what was asked for besides.

    Args:
        console: Where to print; nothing is cut off at its width.
        found: What to print.
        lengths: The model's lengths as symbols or as numbers.
    """
    _print_bodies(console, found, lengths)
    for line in _explained(found, lengths):
        console.print(line, soft_wrap=True)
    if found.seen:
        console.print(map_table(found.tree, found.seen))
        console.print(
            f"{GLYPHS[2]} identifiable alone, {GLYPHS[1]} in combination, {GLYPHS[0]} not"
            f"{' or fixed to zero' * bool(found.dynamic.known_zero.any())}; in the "
            f"order {' '.join(STANDARD)} about the body frame"
        )
    for line in _verdicts(found):
        console.print(line, soft_wrap=True)
    beyond = parameter_names(found.tree)[10 * found.tree.massless :]
    never = [each.never for each in found.sets]
    lost = [name for name in beyond if all(name in each for each in never)]
    if lost:
        console.print(
            f"not identifiable, not even in combination: {', '.join(lost)}", soft_wrap=True
        )
    console.print(_summary(found), soft_wrap=True)


def print_latex(console: Console, found: Findings, lengths: Lengths) -> None:
    """The formulas as lines of an aligned display.

    Args:
        console: Where to print.
        found: What to print.
        lengths: The model's lengths as symbols or as numbers.
    """
    for each in found.sets:
        console.print(f"% {each.model}: {each.count}")
        formulas = found.formulas(each.model, lengths)
        for formula in (*formulas, *each.auxiliary_with(lengths)):
            console.print(rf"{formula.latex('&=')} \\", soft_wrap=True)
    for line in _verdicts(found):
        console.print(f"% {line}", soft_wrap=True)
    console.print(f"% {_summary(found)}", soft_wrap=True)


def map_table(tree: Tree, seen: Sequence[Visibility]) -> Table:
    """A row a body, a column an instrument, ten glyphs for the ten standard parameters."""
    table = Table(box=None, padding=(0, GAP, 0, 0), header_style="bold")
    table.add_column("body", overflow="fold")
    for each in seen:
        sensor = {"tared bedplate": "plate, tared"}.get(each.instrument, each.instrument)
        sensor = sensor.replace("bedplate", "plate")
        table.add_column(f"{sensor} ({each.count})", width=len(STANDARD))
    for j, joint in list(enumerate(tree.joints))[tree.massless :]:
        cells = ["".join(GLYPHS[level] for level in each.standard[j]) for each in seen]
        table.add_row(joint.body, *cells)
    return table


def _print_bodies(console: Console, found: Findings, lengths: Lengths) -> None:
    """Body by body, tips first and the bedplate last, under one row of headings."""
    lines = _lines(found, lengths)
    labels = [line.formula.left for each in lines.values() for line in each]
    marks = dict(HEADINGS)
    if found.tree.sensor is not None:
        marks = {"unit": HEADINGS["unit"], "sensor": HEADINGS["plate"]}
    widths = [_name_width(labels, console.width), *marks.values()]
    rest = console.width - sum(widths) - GAP * (len(widths) + 1)
    below = rest < LEAST
    headings = [NAME, *marks, *(() if below else ("combination of",))]
    console.print(_columns(headings, widths), style="bold", soft_wrap=True)
    for body in sorted(lines, reverse=True):
        for part in textwrap.wrap(
            _heading(found, body), console.width, subsequent_indent=" " * GAP
        ):
            console.print(part, style="bold", soft_wrap=True)
        for line in lines[body]:
            name = broken_name(line.formula.left, widths[0])
            said = [] if line.formula.trivial else summands(line.formula.right, "text") or ["0"]
            made = [] if below else broken_sum(said, rest)
            for k in range(max(len(name), len(made))):
                every = {"unit": line.unit, "torques": line.torques}
                shown = [every.get(mark, line.bedplate) if k == 0 else "" for mark in marks]
                cells = ("".join(name[k : k + 1]), *shown, "".join(made[k : k + 1]))
                console.print(_columns(cells, widths), soft_wrap=True)
            if below and said:
                for part in broken_sum(["=", *said], console.width - 3 * GAP):
                    console.print(" " * 3 * GAP + part, soft_wrap=True)


def _name_width(labels: Sequence[Label], width: int) -> int:
    """What names take: their share, or what their longest piece needs if there is room."""
    longest = max((len(label.text) for label in labels), default=0)
    piece = max((len(piece) for label in labels for piece in label.pieces), default=0)
    room = width - sum(HEADINGS.values()) - GAP * (len(HEADINGS) + 1)
    wanted = min(longest, max(piece, width // SHARE))
    return max(len(NAME), min(wanted, room))


def _columns(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells side by side, set in; the last takes what it needs."""
    padded = (f"{cell:{width + GAP}}" for cell, width in zip(cells, widths, strict=False))
    return " " * GAP + ("".join(padded) + "".join(cells[len(widths) :])).rstrip()


def broken_sum(pieces: Sequence[str], width: int) -> list[str]:
    """A sum in lines, broken between its terms, and within one only if that is too long."""
    lines: list[str] = []
    for piece in pieces:
        if lines and len(lines[-1]) + 1 + len(piece) <= width:
            lines[-1] += f" {piece}"
        else:
            lines += textwrap.wrap(piece, width, break_on_hyphens=False)
    return lines


def broken_name(label: Label, width: int) -> list[str]:
    """A name in lines, broken between its terms, and within one only if that is too long."""
    if len(label.text) <= width:
        return [label.text]
    return [line for piece in label.pieces for line in textwrap.wrap(piece, width)]


def _lines(found: Findings, lengths: Lengths) -> dict[int, list[_Line]]:
    """One line a parameter by body; torques and bedplate share it where they mean the same."""
    lines: dict[int, dict[Formula, _Line]] = {}
    for each in found.sets:
        formulas = found.formulas(each.model, lengths)
        rows = zip(formulas, each.units, each.bodies, each.reasons, strict=True)
        for formula, unit, body, reason in rows:
            known = lines.setdefault(body, {})
            line = known.get(formula, _Line(formula, unit))
            torques = each.model == "dynamic"
            known[formula] = (
                replace(line, torques=reason) if torques else replace(line, bedplate=reason)
            )
    return {body: list(known.values()) for body, known in lines.items()}


def _heading(found: Findings, body: int) -> str:
    if body < 0:
        return "the bedplate"
    joint = found.tree.joints[body]
    kind = "revolute" if joint.revolute else "prismatic"
    carrier = found.tree.joints[joint.parent].body if joint.parent >= 0 else "the bedplate"
    return f"{body + 1}  {joint.body}, {kind} on {carrier}"


def _explained(found: Findings, lengths: Lengths) -> Iterator[str]:
    """Rules, redefinitions, directions and terms of the joints, a line each."""
    for number in sorted({reason for each in found.sets for reason in each.reasons}):
        yield f"{'rule ' * number[0].isdigit()}{number}: {REASONS[number]}"
    sets = {"torques": found.sets[0], "plate": found.reaction}
    said = {name: each.auxiliary_with(lengths) for name, each in sets.items()}
    other = {name: {f.left: f for f in said[name]} for name in sets}
    for formula in dict.fromkeys((*said["torques"], *said["plate"])):
        of = [name for name in sets if other[name].get(formula.left) == formula]
        differs = len({f for name in sets if (f := other[name].get(formula.left))}) > 1
        yield f"with {formula}{f' ({of[0]})' if differs else ''}"
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
    for law in dict.fromkeys(term.law for term in drives.asked):
        names = places(tree)
        joints = [names[term.joint] for term in drives.terms if term.law == law]
        if joints:
            whose = "every joint" if tuple(joints) == tree.names else ", ".join(joints)
            yield f"{law.kind}: a column of its own for {whose}"
    for term, column in drives.regrouped.items():
        holders = [name for name, share in zip(drives.names, column, strict=True) if share]
        beside = " and ".join(holders)
        yield f"{drives.symbol(term).text}: identifiable only in combination with {beside}"


def _summary(found: Findings) -> str:
    tared = " (tared)" if found.reaction.tared else ""
    count = plural(found.sets[0].count, "combination")
    phrase = (
        f"{count} identifiable by joint torques, {found.reaction.count} by the force plate{tared}"
    )
    if found.tree.sensor is not None:
        phrase = f"{count} identifiable by the force sensor{tared}"
    drives = found.drives
    terms = (
        f"; with terms of the joints, {plural(drives.count, 'unknown')}"
        if drives is not None
        else ""
    )
    bodies = found.tree.n - found.tree.massless
    return f"{found.tree.name}: {10 * bodies} parameters; {phrase}{terms}"


def _verdicts(found: Findings) -> Iterator[str]:
    """What the witnesses say, a line each."""
    for each in found.agreements:
        yield (
            f"{each.model}: three methods {_agree(each.holds)}: rules {each.rules}, exact "
            f"recursion {each.recursion} (row spaces apart by {each.recursion_distance:.0e}), "
            f"sampled regressor {each.sampled} ({each.sampled_distance:.0e}, singular-value gap "
            f"{each.gap:.0e}); regrouping changes the model by {each.change:.0e}"
        )
    drives = found.drives_agree
    if drives is not None:
        yield (
            f"with terms of the joints: two methods {_agree(drives.holds)}: exact recursion "
            f"{drives.count}, sampled columns {drives.sampled} (singular-value gap "
            f"{drives.gap:.0e}); regrouping changes the model by {drives.change:.0e}"
        )


def _agree(holds: bool) -> str:
    return "agree" if holds else "DISAGREE"


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
