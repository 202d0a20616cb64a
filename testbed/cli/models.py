"""Commands about models: minimal, equations; and lists of the faults and effects there are."""

from __future__ import annotations

import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn

import typer

from testbed.cli.options import (
    Fields,
    Force,
    Json,
    Model,
    Vector,
    check_outputs,
    command,
)
from testbed.cli.reading import Reading
from testbed.core.base.errors import UnknownName

if TYPE_CHECKING:
    from testbed.core.parameters.identifiability import Visibility
    from testbed.core.robot.tree import Tree
    from testbed.sensors.kinds_in_words import KindDescription


class What(StrEnum):
    """Equations to choose from; typer takes no list of literals."""

    joint_forces = "joint-forces"
    base_wrench = "base-wrench"
    dynamic_regressor = "dynamic-regressor"
    reaction_regressor = "reaction-regressor"
    mass_matrix = "mass-matrix"
    gravity_forces = "gravity-forces"
    all = "all"


Form = Literal["full", "reduced", "recursive"]


@command()
def minimal(
    reading: Annotated[
        Reading,
        Fields(
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
    """Print what joint torques and what a force plate or sensor can identify of a robot.

    Example: testbed minimal models/puma562.urdf --zeros --map --verify
    """
    from testbed.core.dynamics.drive_set import drive_set
    from testbed.core.dynamics.gravity_rotations import unidentifiable_rotations
    from testbed.core.dynamics.rank_check import verify, verify_drives
    from testbed.core.parameters.minimal_set import minimal_set
    from testbed.core.robot.placeholders import placeholders
    from testbed.view import output
    from testbed.view.minimal_sets import Findings, as_document, print_latex, print_sets

    tree = reading.tree
    gravity, known = reading.gravity, reading.known_zeros
    with output.Progress("deriving"):
        dynamic = minimal_set(tree, "dynamic", gravity, known)
        reaction = minimal_set(tree, "reaction", gravity, known, tared)
        drives = drive_set(tree, dynamic, terms) if terms else None
        seen = _map(tree, gravity, known) if show_map or as_json else ()
        found = Findings(tree, dynamic, reaction, drives, seen)
        if check:
            drives_agree = [] if drives is None else [verify_drives(tree, drives)]
            sets_agree = [verify(tree, each) for each in found.sets]
            found = replace(found, agreements=[*sets_agree, *drives_agree])
    lengths: Literal["symbols", "numbers"] = "numbers" if numbers else "symbols"
    if as_json:
        output.print_json(as_document(found, matrices))
    elif as_latex:
        print_latex(output.console(), found, lengths)
    else:
        said = [*tree.diagnostics, *placeholders(tree).diagnostics]
        if any(gravity or ()) and not (tree.floating or tree.is_part):
            said.append(unidentifiable_rotations(tree, dynamic))
        output.print_diagnostics(output.console(), said)
        print_sets(output.console(), found, lengths)
    raise typer.Exit(0 if found.hold else 1)


@command()
def equations(
    what: Annotated[
        list[What] | None, typer.Option(help="Which equations; repeatable.")
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
        Reading,
        Fields(
            "zeros", "zero", "gravity", "weld_root", "lock", "lock_mimic", model=Model
        ),
    ],
    square: Annotated[
        bool,
        typer.Option("--right-angles", help="Round almost right angles."),
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
    """Write a robot's literal equations: motion, reaction, regressors.

    Example: testbed equations models/puma562.xml --zeros --form reduced
    """
    from testbed.core.base.contents import fingerprint
    from testbed.core.base.whole_files import write_whole
    from testbed.equations.equations import KINDS
    from testbed.equations.equations import equations as derived
    from testbed.equations.expression import MAX_TERMS
    from testbed.equations.languages import as_document, write_equations
    from testbed.equations.robot import right_angles
    from testbed.view import output

    model = reading.file.path
    tree = right_angles(reading.tree) if square else reading.tree
    check_outputs(out, force=force, read=(model, against))
    if reading.zeros and reading.zero:
        raise typer.BadParameter(
            "--zeros takes those of the file, --zero NAME others: give one"
        )
    gravity, known, most = reading.gravity, reading.known_zeros, max_terms or MAX_TERMS
    if against is not None:
        if what or out is not None or as_json:
            raise typer.BadParameter(
                "--against compares and writes nothing: leave --what, --out, --json out"
            )
        _compare(tree, against, form, gravity, known, most)
    wanted = what or [What.joint_forces]
    names = list(KINDS) if What.all in wanted else [each.value for each in wanted]
    with output.Progress("deriving"):
        listing = derived(tree, names, form, gravity, known, most)
        text = write_equations(
            listing, language, f"{model.name}, SHA-256 {fingerprint(model)[:16]}"
        )
    if out is not None:
        write_whole(out, text)
    if as_json:
        output.print_json(as_document(listing, text))
    elif out is None:
        sys.stdout.write(text)


def _map(
    tree: Tree, gravity: Vector | None, known: bool | list[str]
) -> tuple[Visibility, ...]:
    """What each sensor identifies; SciPy's sparse matrices take a third of a second to import."""
    from testbed.core.parameters.identifiability import identifiability

    return identifiability(tree, gravity, known)


def _compare(
    tree: Tree,
    path: Path,
    form: Form,
    gravity: tuple[float, float, float] | None,
    zeros: bool | list[str],
    max_terms: int,
) -> NoReturn:
    """Say where a listing differs; exit code 1 if it does."""
    from testbed.core.base.contents import read_text
    from testbed.equations.compare import TERM_LENGTH, compare_equations
    from testbed.equations.languages.latex import line
    from testbed.view import output

    # a character has up to four bytes
    text = read_text(path, 4 * TERM_LENGTH * max_terms)
    with output.Progress("deriving"):
        found = compare_equations(tree, text, form, gravity, zeros, max_terms)
    for name, difference in found.items():
        same = (
            "equal"
            if not difference
            else f"the listing less the robot: {line(difference)}"
        )
        sys.stdout.write(f"{name}: {same}\n")
    raise typer.Exit(1 if any(found.values()) else 0)


Kind = Annotated[
    str | None, typer.Argument(metavar="KIND", help="One of them, with its keys.")
]


@command("list")
def list_(kind: Kind = None) -> None:
    """List errors of encoders, drives and plate, effects in the plant, terms of joint torques.

    Example: testbed list plate_pose
    """
    from testbed.core.robot.friction import LAWS, VARYING
    from testbed.lab.simulation.effects import KINDS as EFFECTS
    from testbed.sensors.catalogue import simulated_errors
    from testbed.sensors.kinds_in_words import in_words

    tables = {"[measurement] fault": simulated_errors(), "[simulation] effect": EFFECTS}
    for table, kinds in tables.items():
        if kind is None:
            typer.echo(f"{table} = [{{ kind = ... }}]")
            for each in kinds.values():
                typer.echo(f"  {each.kind:26s}{in_words(each).summary}")
        elif kind in kinds:
            _describe(in_words(kinds[kind]), table)
            return
    if kind is not None:
        raise UnknownName("kind", kind, (*simulated_errors(), *EFFECTS))
    typer.echo("One of them, with its keys: testbed list KIND")
    typer.echo("[identification] terms = [...], units at joints that turn, that slide")
    for law in (*LAWS, *VARYING):
        typer.echo(f"  {law.kind:26s}{law.turning}, {law.sliding}")


def _describe(entry: KindDescription, key: str) -> None:
    typer.echo("\n".join(filter(None, (entry.summary, entry.details))))
    for name, default, meaning in entry.keys:
        typer.echo(f"  {name} = {default}: {meaning}")
    typer.echo(f"Source of the size: {entry.source}")
    typer.echo(f"In an experiment: {key} = [{entry.example}]")
