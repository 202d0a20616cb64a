"""Commands for robot models: minimal, equations; and list, of sensor errors and effects."""

from __future__ import annotations

import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn

import typer

from testbed.cli.options import (
    Force,
    GravityVector,
    Json,
    Model,
    OptionFields,
    check_outputs,
    command,
)
from testbed.cli.reading import ReadingOptions
from testbed.core.base.errors import UnknownName

if TYPE_CHECKING:
    from testbed.core.parameters.identifiability import InstrumentIdentifiability
    from testbed.core.robot.tree import Tree
    from testbed.sensors.kinds_in_words import KindDescription


class EquationName(StrEnum):
    """Names of the kinds of equations, as an enumeration for Typer.

    Typer does not support a list of literals.
    """

    joint_forces = "joint-forces"
    base_wrench = "base-wrench"
    torque_regressor = "torque-regressor"
    wrench_regressor = "wrench-regressor"
    mass_matrix = "mass-matrix"
    gravity_forces = "gravity-forces"
    all = "all"


Form = Literal["full", "reduced", "recursive"]


@command()
def minimal(
    reading: Annotated[
        ReadingOptions,
        OptionFields(
            "zeros",
            "zero",
            "gravity",
            "sensor",
            "weld_root",
            "lock",
            "lock_mimic",
            model=Model,
        ),
    ],
    tared: Annotated[
        bool,
        typer.Option(
            "--tared", help="The static wrench is subtracted (tared force plate)."
        ),
    ] = False,
    show_map: Annotated[
        bool,
        typer.Option("--map", help="Show which parameters each sensor identifies."),
    ] = False,
    check: Annotated[
        bool,
        typer.Option("--verify", help="Verify the sets by two independent methods."),
    ] = False,
    numbers: Annotated[
        bool, typer.Option("--numbers", help="Print lengths as numbers.")
    ] = False,
    as_latex: Annotated[
        bool, typer.Option("--latex", help="Print the formulas in LaTeX.")
    ] = False,
    terms: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TERM",
            help="A joint term, e.g. rotor or offset; repeatable.",
        ),
    ] = None,
    matrices: Annotated[
        bool,
        typer.Option(
            "--matrices/--no-matrices", help="With --json: include the matrices."
        ),
    ] = True,
    as_json: Json = False,
) -> None:
    """Print the minimal parameter sets of joint torques, and of a force plate or sensor.

    Example: testbed minimal models/puma562.urdf --zeros --map --verify
    """
    from testbed.core.dynamics.drive_set import make_drive_set
    from testbed.core.dynamics.gravity_rotations import gravity_rotation_diagnostic
    from testbed.core.dynamics.rank_check import verify_drive_set, verify_minimal_set
    from testbed.core.parameters.minimal_set import minimal_set
    from testbed.core.robot.placeholders import find_placeholders
    from testbed.view import output
    from testbed.view.minimal_sets import (
        IdentifiabilityReport,
        minimal_sets_document,
        print_latex,
        print_sets,
    )

    tree = reading.tree
    gravity, known_zeros = reading.gravity, reading.known_zeros
    with output.Progress("deriving"):
        torque_set = minimal_set(tree, "torque", gravity, known_zeros)
        wrench_set = minimal_set(tree, "wrench", gravity, known_zeros, tared)
        drives = make_drive_set(tree, torque_set, terms) if terms else None
        identifiable = (
            _identifiable_parameters(tree, gravity, known_zeros)
            if show_map or as_json
            else ()
        )
        findings = IdentifiabilityReport(
            tree, torque_set, wrench_set, drives, identifiable
        )
        if check:
            drives_agree = [] if drives is None else [verify_drive_set(tree, drives)]
            sets_agree = [verify_minimal_set(tree, each) for each in findings.sets]
            findings = replace(findings, agreements=[*sets_agree, *drives_agree])
    lengths: Literal["symbols", "numbers"] = "numbers" if numbers else "symbols"
    if as_json:
        output.print_json(minimal_sets_document(findings, matrices))
    elif as_latex:
        print_latex(output.console(), findings, lengths)
    else:
        diagnostics = [*tree.diagnostics, *find_placeholders(tree).diagnostics]
        if any(gravity or ()) and not (tree.floating or tree.is_part):
            diagnostics.append(gravity_rotation_diagnostic(tree, torque_set))
        output.print_diagnostics(output.console(), diagnostics)
        print_sets(output.console(), findings, lengths)
    raise typer.Exit(0 if findings.all_agree else 1)


@command()
def equations(
    what: Annotated[
        list[EquationName] | None, typer.Option(help="Equations to write; repeatable.")
    ] = None,
    form: Annotated[
        Form,
        typer.Option(help="All parameters, base parameters, or recursive form."),
    ] = "full",
    language: Annotated[
        Literal["paper", "latex", "python", "c"], typer.Option(help="Notation.")
    ] = "paper",
    *,
    reading: Annotated[
        ReadingOptions,
        OptionFields(
            "zeros", "zero", "gravity", "weld_root", "lock", "lock_mimic", model=Model
        ),
    ],
    square: Annotated[
        bool,
        typer.Option(
            "--right-angles",
            help="Round angles that are almost multiples of 90 degrees.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="File to write; default the terminal.")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="Listing to compare with."),
    ] = None,
    max_terms: Annotated[
        int | None, typer.Option(min=1, help="Largest number of terms; default 150000.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write a robot's symbolic equations: joint forces, base wrench, regressors, mass matrix.

    Example: testbed equations models/puma562.xml --zeros --form reduced
    """
    from testbed.core.base.contents import sha256_of_file
    from testbed.core.base.whole_files import write_atomically
    from testbed.equations.equations import KINDS
    from testbed.equations.equations import equations as derive_equations
    from testbed.equations.expression import MAX_TERMS
    from testbed.equations.languages import as_document, write_equations
    from testbed.equations.robot import with_right_angles
    from testbed.view import output

    model = reading.file.path
    tree = with_right_angles(reading.tree) if square else reading.tree
    check_outputs(out, force=force, read=(model, against))
    if reading.zeros and reading.zero:
        raise typer.BadParameter(
            "--zeros takes those of the file, --zero NAME others: give one"
        )
    gravity, known_zeros, limit = (
        reading.gravity,
        reading.known_zeros,
        max_terms or MAX_TERMS,
    )
    if against is not None:
        if what or out is not None or as_json:
            raise typer.BadParameter(
                "--against compares and writes nothing: leave --what, --out, --json out"
            )
        _print_comparison(tree, against, form, gravity, known_zeros, limit)
    kinds = what or [EquationName.joint_forces]
    names = list(KINDS) if EquationName.all in kinds else [each.value for each in kinds]
    with output.Progress("deriving"):
        listing = derive_equations(tree, names, form, gravity, known_zeros, limit)
        text = write_equations(
            listing, language, f"{model.name}, SHA-256 {sha256_of_file(model)[:16]}"
        )
    if out is not None:
        write_atomically(out, text)
    if as_json:
        output.print_json(as_document(listing, text))
    elif out is None:
        sys.stdout.write(text)


def _identifiable_parameters(
    tree: Tree, gravity: GravityVector | None, known: bool | list[str]
) -> tuple[InstrumentIdentifiability, ...]:
    """Identifiability of each standard parameter by each instrument (see `identifiability`).

    The import in this function takes a third of a second because of SciPy's sparse matrices, so it
    is not at the top of the module.

    Args:
        tree: The robot.
        gravity: Gravity, bedplate frame [m/s^2]; None for the gravity of the model file.
        known: Barycentric parameters known to be zero: a list of names, or True for all parameters
            that are zero in the model file.
    """
    from testbed.core.parameters.identifiability import identifiability

    return identifiability(tree, gravity, known)


def _print_comparison(
    tree: Tree,
    path: Path,
    form: Form,
    gravity: tuple[float, float, float] | None,
    zeros: bool | list[str],
    max_terms: int,
) -> NoReturn:
    """Print the comparison of a listing of equations with the robot's equations.

    For each equation, the output is "equal", or the difference `listing - robot`. The arguments are
    those of `compare_equations`, with a file for the listing.

    Raises:
        Exit: Always; the code is 1 if an equation differs, else 0.
    """
    from testbed.core.base.contents import read_text
    from testbed.equations.compare import CHARACTERS_PER_TERM, compare_equations
    from testbed.equations.languages.latex import expression_line
    from testbed.view import output

    # a character has up to four bytes
    text = read_text(path, 4 * CHARACTERS_PER_TERM * max_terms)
    with output.Progress("deriving"):
        differences = compare_equations(tree, text, form, gravity, zeros, max_terms)
    for name, difference in differences.items():
        outcome = (
            "equal"
            if not difference
            else f"the listing less the robot: {expression_line(difference)}"
        )
        sys.stdout.write(f"{name}: {outcome}\n")
    raise typer.Exit(1 if any(differences.values()) else 0)


Kind = Annotated[
    str | None, typer.Argument(metavar="KIND", help="Kind to describe, with its keys.")
]


@command("list")
def list_(kind: Kind = None) -> None:
    """List simulated errors of encoders, drives and plate, effects in the plant, and joint terms.

    Example: testbed list plate_pose
    """
    from testbed.core.robot.friction import DRIFT_LAWS, JOINT_LAWS
    from testbed.lab.simulation.effects import EFFECT_KINDS as EFFECTS
    from testbed.sensors.catalogue import simulated_errors
    from testbed.sensors.kinds_in_words import describe_kind

    tables = {"[measurement] fault": simulated_errors(), "[simulation] effect": EFFECTS}
    for table, kinds in tables.items():
        if kind is None:
            typer.echo(f"{table} = [{{ kind = ... }}]")
            for each in kinds.values():
                typer.echo(f"  {each.kind:26s}{describe_kind(each).summary}")
        elif kind in kinds:
            _print_kind(describe_kind(kinds[kind]), table)
            return
    if kind is not None:
        raise UnknownName("kind", kind, (*simulated_errors(), *EFFECTS))
    typer.echo("One of them, with its keys: testbed list KIND")
    typer.echo("[identification] terms = [...], units at joints that turn, that slide")
    for law in (*JOINT_LAWS, *DRIFT_LAWS):
        typer.echo(f"  {law.kind:26s}{law.revolute_unit}, {law.prismatic_unit}")


def _print_kind(entry: KindDescription, key: str) -> None:
    """Print the description of a simulated error or effect.

    It consists of a summary, keys with defaults, source and example.

    Args:
        entry: Description of the kind of sensor error or plant effect.
        key: Key in an experiment file under which the kind is given.
    """
    typer.echo("\n".join(filter(None, (entry.summary, entry.details))))
    for name, default, meaning in entry.keys:
        typer.echo(f"  {name} = {default}: {meaning}")
    typer.echo(f"Source of the size: {entry.source}")
    typer.echo(f"In an experiment: {key} = [{entry.example}]")
