"""Output of minimal parameter sets: terminal tables, LaTeX, JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from testbed.core.base.errors import count_with_noun
from testbed.core.dynamics.rank_check import Agreement, DriveAgreement
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet, selection
from testbed.core.parameters.regroup import LengthNotation
from testbed.core.parameters.rules import RULE_REASONS
from testbed.core.parameters.symbols import STANDARD_NAMES, Formula, parameter_names
from testbed.core.robot.shafts import joint_and_shaft_names
from testbed.core.robot.tree import Tree

if TYPE_CHECKING:
    from testbed.core.parameters.identifiability import InstrumentIdentifiability


IDENTIFIABILITY_GLYPHS = ("·", "+", "#")
"""Glyphs of parameters that are never identifiable, in combination, or alone."""

COLUMN_GAP = 2
"""Number of blanks between columns."""

MIN_COLUMN_WIDTHS = (6, 7, 8)
"""Smallest widths of the columns between name and formula: unit, joint torques, force plate."""

SENSOR_PHRASES = {
    "torques": "joint torques",
    "plate": "the force plate",
    "sensor": "the force sensor",
}
"""Names of the sensors in sentences."""

NAME_WIDTH_DIVISOR = 3
"""Console width over the largest width of the names of parameters; longer names are folded."""


@dataclass(frozen=True, eq=False)
class IdentifiabilityReport:
    """Minimal sets of a robot, identifiability map, and checks by independent methods.

    Attributes:
        tree: The robot.
        dynamic: Minimal set of the joint torques, delta_d.
        reaction: Minimal set of the force plate or force sensor, delta_r.
        drive_set: Minimal set of the joint torques with joint terms; None if not requested.
        seen: Identifiability of the standard parameters by each instrument, printed as a map; () if
            not requested.
        agreements: Comparisons of each set with numerical methods; () if not requested.
    """

    tree: Tree
    dynamic: MinimalSet
    reaction: MinimalSet
    drive_set: DriveSet | None = None
    seen: Sequence[InstrumentIdentifiability] = ()
    agreements: Sequence[Agreement | DriveAgreement] = ()

    @property
    def sets_by_sensor(self) -> dict[str, MinimalSet]:
        """Minimal sets keyed by sensor.

        For a robot with a force sensor, only the set of that sensor is included.
        """
        if self.tree.sensor is not None:
            return {"sensor": self.reaction}
        return {"torques": self.dynamic, "plate": self.reaction}

    @property
    def sets(self) -> tuple[MinimalSet, ...]:
        """Minimal sets of the robot's sensors."""
        return tuple(self.sets_by_sensor.values())

    @property
    def all_agree(self) -> bool:
        """True if all comparisons with independent methods agree."""
        return all(each.agrees for each in self.agreements)

    def formulas(
        self, minimal: MinimalSet, lengths: LengthNotation
    ) -> tuple[Formula, ...]:
        """Formulas of a minimal set's parameters in terms of barycentric parameters.

        For joint torques with a `drive_set`, they include the joint terms that are regrouped into
        the parameters.

        Args:
            minimal: One of the minimal sets.
            lengths: Notation for lengths of the model: symbols or numbers.
        """
        if minimal.model == "wrench" or self.drive_set is None:
            return minimal.formulas_with(lengths)
        return self.drive_set.formulas_with(lengths)[: minimal.count]


def print_sets(
    console: Console, report: IdentifiabilityReport, lengths: LengthNotation
) -> None:
    """Print the minimal sets body by body, then explanations, map and checks.

    The last lines list parameters that no sensor identifies, even in combination, and the numbers
    of combinations.

    Args:
        console: Console of the output; text is not truncated at its width.
        report: Minimal sets, map and checks.
        lengths: Notation for lengths of the model: symbols or numbers.
    """
    _print_bodies(console, report, lengths)
    for line in _explanation_lines(report, lengths):
        console.print(line)
    if report.seen:
        console.print(identifiability_table(report.tree, report.seen))
        console.print(
            f"{IDENTIFIABILITY_GLYPHS[2]} identifiable alone, "
            f"{IDENTIFIABILITY_GLYPHS[1]} in combination, {IDENTIFIABILITY_GLYPHS[0]} not"
            f"{' or fixed to zero' * bool(report.dynamic.known_zero.any())}; in the "
            f"order {' '.join(STANDARD_NAMES)} about the body frame"
        )
    for line in _agreement_lines(report):
        console.print(line)
    names = parameter_names(report.tree)[10 * report.tree.massless :]
    never_identifiable = set.intersection(
        *(set(each.unidentifiable) for each in report.sets)
    )
    if unidentifiable := [name for name in names if name in never_identifiable]:
        console.print(
            f"not identifiable, not even in combination: {', '.join(unidentifiable)}"
        )
    console.print(_summary_sentence(report))


def print_latex(
    console: Console, report: IdentifiabilityReport, lengths: LengthNotation
) -> None:
    """Print the formulas of the minimal sets as lines of an aligned LaTeX display.

    Numbers of parameters, checks and summary are written as LaTeX comments.

    Args:
        console: Console of the output.
        report: Minimal sets and checks.
        lengths: Notation for lengths of the model: symbols or numbers.
    """
    for each in report.sets:
        console.print(f"% {each.model}: {each.count}")
        for formula in (*report.formulas(each, lengths), *each.auxiliary_with(lengths)):
            console.print(rf"{formula.latex('&=')} \\")
    for line in _agreement_lines(report):
        console.print(f"% {line}")
    console.print(f"% {_summary_sentence(report)}")


def identifiability_table(
    tree: Tree, instruments: Sequence[InstrumentIdentifiability]
) -> Table:
    """Table of identifiability with one row per body and one column per instrument.

    A cell contains one glyph of `IDENTIFIABILITY_GLYPHS` for each of the ten standard parameters,
    in the order of `STANDARD_NAMES`. Massless bodies are left out.

    Args:
        tree: The robot.
        instruments: Identifiability by each instrument.
    """
    table = Table(box=None, padding=(0, COLUMN_GAP, 0, 0), header_style="bold")
    table.add_column("body", overflow="fold")
    for instrument in instruments:
        sensor = {"tared bedplate": "plate, tared"}.get(
            instrument.instrument, instrument.instrument
        )
        sensor = sensor.replace("bedplate", "plate")
        table.add_column(f"{sensor} ({instrument.count})", width=len(STANDARD_NAMES))
    for j, joint in list(enumerate(tree.joints))[tree.massless :]:
        cells = [
            "".join(IDENTIFIABILITY_GLYPHS[level] for level in instrument.standard[j])
            for instrument in instruments
        ]
        table.add_row(joint.body, *cells)
    return table


def _print_bodies(
    console: Console, report: IdentifiabilityReport, lengths: LengthNotation
) -> None:
    """Print a table per body: parameter, unit, rule in each sensor's set, and formula.

    The rule, a key of `RULE_REASONS`, states why the parameter is in the set; it is "-" if the
    parameter is not. Bodies are in descending order, with the bedplate last.
    """
    rows = _formula_rows(report, lengths)
    names = [formula.left.text for formulas in rows.values() for formula in formulas]
    width = min(max(map(len, names), default=0), console.width // NAME_WIDTH_DIVISOR)
    for body in sorted(rows, reverse=True):
        console.print(_body_heading(report, body), style="bold")
        table = Table(box=None, padding=(0, 0, 0, COLUMN_GAP), header_style="bold")
        table.add_column(
            "parameter", width=max(width, len("parameter")), overflow="fold"
        )
        table.show_header = body == max(rows)
        for head, min_width in zip(
            ("unit", *report.sets_by_sensor), MIN_COLUMN_WIDTHS, strict=False
        ):
            table.add_column(head, min_width=min_width)
        table.add_column("combination of", overflow="fold")
        for formula, row in rows[body].items():
            rules = (
                row.get(sensor, "-") for sensor in ("unit", *report.sets_by_sensor)
            )
            table.add_row(
                formula.left.text,
                *rules,
                "" if formula.is_trivial else formula.right_text,
            )
        console.print(table)


def _formula_rows(
    report: IdentifiabilityReport, lengths: LengthNotation
) -> dict[int, dict[Formula, dict[str, str]]]:
    """Table cells keyed by body index and formula.

    The cells of a formula are "unit", and the rule keyed by sensor; a sensor is missing if its set
    does not contain the parameter. The bedplate has the index -1.
    """
    rows: dict[int, dict[Formula, dict[str, str]]] = {}
    for sensor, each in report.sets_by_sensor.items():
        formulas = report.formulas(each, lengths)
        columns = zip(each.bodies, formulas, each.units, each.reasons, strict=True)
        for body, formula, unit, reason in columns:
            row = rows.setdefault(body, {}).setdefault(formula, {"unit": unit})
            row[sensor] = reason
    return rows


def _body_heading(report: IdentifiabilityReport, body: int) -> str:
    """Heading of a body: its number from 1, name, joint type and carrying body."""
    if body < 0:
        return "the bedplate"
    joint = report.tree.joints[body]
    kind = "revolute" if joint.revolute else "prismatic"
    carrier = (
        report.tree.joints[joint.parent].body if joint.parent >= 0 else "the bedplate"
    )
    return f"{body + 1}  {joint.body}, {kind} on {carrier}"


def _explanation_lines(
    report: IdentifiabilityReport, lengths: LengthNotation
) -> Iterator[str]:
    """Yield lines on the rules in use, auxiliary parameters, axis directions and joint terms.

    Auxiliary formulas define the starred parameters; the sensor is added if they differ between
    sets. Axis directions are the triads of parameters whose directions are not along body axes.
    """
    for number in sorted({reason for each in report.sets for reason in each.reasons}):
        yield f"{'rule ' * number[0].isdigit()}{number}: {RULE_REASONS[number]}"
    sensors: dict[Formula, list[str]] = {}
    for sensor, each in report.sets_by_sensor.items():
        for formula in each.auxiliary_with(lengths):
            sensors.setdefault(formula, []).append(sensor)
    for formula, names in sensors.items():
        yield f"with {formula}{f' ({names[0]})' if len(names) < len(report.sets) else ''}"
    for body, triad in (report.sets[0].triads | report.reaction.triads).items():
        axes = (
            f"{letter} = ({x:.6g}, {y:.6g}, {z:.6g})"
            for letter, (x, y, z) in zip(triad.letters, triad.axes, strict=True)
        )
        yield f"in {f'body {body + 1}' if body >= 0 else 'the bedplate'}, {', '.join(axes)}"
    if report.drive_set is not None:
        yield from _joint_term_lines(report.drive_set, report.tree)


def _joint_term_lines(drives: DriveSet, tree: Tree) -> Iterator[str]:
    """Yield lines on joint terms with a separate unknown, then on regrouped terms.

    A line on a law lists the joints whose term is a separate unknown. A line on a regrouped term
    lists the unknowns that contain it.
    """
    names = joint_and_shaft_names(tree)
    for law in dict.fromkeys(term.law for term in drives.asked):
        joints = [names[term.joint] for term in drives.terms if term.law == law]
        if joints:
            yield f"{law.kind}: a column of its own for {', '.join(joints)}"
    for term, column in drives.regrouped.items():
        holders = [
            name for name, share in zip(drives.names, column, strict=True) if share
        ]
        combination = " and ".join(holders)
        yield f"{drives.symbol(term).text}: identifiable only in combination with {combination}"


def _summary_sentence(report: IdentifiabilityReport) -> str:
    """Sentence with the number of parameters, and of combinations that each sensor identifies.

    With joint terms, the number of unknowns of the joint torques follows.
    """
    (first, *others), (count, *counts) = (
        report.sets_by_sensor,
        [each.count for each in report.sets],
    )
    phrase = f"{count_with_noun(count, 'combination')} identifiable by {SENSOR_PHRASES[first]}"
    for sensor, count in zip(others, counts, strict=True):
        phrase += f", {count} by {SENSOR_PHRASES[sensor]}"
    phrase += " (tared)" * report.reaction.tared
    if report.drive_set is not None:
        phrase += (
            "; with terms of the joints, "
            f"{count_with_noun(report.drive_set.count, 'unknown')}"
        )
    bodies = report.tree.n - report.tree.massless
    return f"{report.tree.name}: {10 * bodies} parameters; {phrase}"


def _agreement_lines(report: IdentifiabilityReport) -> Iterator[str]:
    """Yield one line per comparison: ranks from each method, distances, and agreement.

    The methods are the rules, the exact recursion and the sampled regressor; with joint terms, only
    the last two.
    """
    for each in report.agreements:
        agree = "agree" if each.agrees else "DISAGREE"
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


def minimal_sets_document(
    report: IdentifiabilityReport, matrices: bool = True
) -> dict[str, Any]:
    """JSON document of the minimal sets, the identifiability map and the checks.

    Args:
        report: Minimal sets, map and checks.
        matrices: True to include the matrices of the sets, and the selection matrix "S" between the
            sets of joint torques and plate.
    """
    sets = report.sets
    document: dict[str, Any] = {
        "robot": report.tree.name,
        "joints": list(report.tree.names),
        "gravity": report.dynamic.gravity.tolist(),
        "parameters": {
            "barycentric": list(parameter_names(report.tree)),
            "standard": list(STANDARD_NAMES),
        },
        **{each.model: _set_document(report.tree, each, matrices) for each in sets},
        "map": [_instrument_document(report.tree, each) for each in report.seen],
        "verified": [
            asdict(each) | {"agrees": each.agrees} for each in report.agreements
        ],
    }
    if matrices and len(sets) > 1:
        document["S"] = selection(*sets).tolist()
    if report.drive_set is not None:
        document["drives"] = _drive_set_document(report.drive_set, matrices)
    return document


def _set_document(tree: Tree, minimal: MinimalSet, matrices: bool) -> dict[str, Any]:
    """JSON document of one minimal set: names, units, formulas, rules, matrices if requested."""
    document = {}
    if matrices:
        document["matrix"] = minimal.matrix.tolist()
        document["standard_matrix"] = minimal.standard_matrix.tolist()
    return document | {
        "names": list(minimal.names),
        "units": list(minimal.units),
        "formulas": [str(formula) for formula in minimal.formulas],
        "auxiliary": [str(formula) for formula in minimal.auxiliary],
        "reasons": [f"{number}: {RULE_REASONS[number]}" for number in minimal.reasons],
        "unidentifiable": list(minimal.unidentifiable),
        "latex": [formula.latex() for formula in minimal.formulas],
        "tared": minimal.tared,
        "known_zero": [
            name
            for name, zero in zip(
                parameter_names(tree), minimal.known_zero.ravel(), strict=True
            )
            if zero
        ],
    }


def _drive_set_document(drives: DriveSet, matrices: bool) -> dict[str, Any]:
    """JSON document of the minimal set with joint terms.

    The key "asked" has all requested terms, "own" the terms with a separate column, and "regrouped"
    the other terms, each with its coefficient in every unknown that contains it.
    """
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


def _instrument_document(
    tree: Tree, identifiability: InstrumentIdentifiability
) -> dict[str, Any]:
    """JSON document of one instrument's identifiability, by body and parameter.

    Values are "never", "combined" (only in combination with other parameters) or "alone".
    """
    words = ("never", "combined", "alone")
    bodies = {
        joint.body: dict(
            zip(STANDARD_NAMES, map(words.__getitem__, levels), strict=True)
        )
        for joint, levels in zip(
            tree.joints, identifiability.standard.tolist(), strict=True
        )
    }
    return {
        "instrument": identifiability.instrument,
        "count": identifiability.count,
        "standard": bodies,
    }
