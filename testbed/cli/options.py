"""The application, and options that several commands share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="A virtual force plate under a robot: minimal dynamic parameters from joint torques "
    "and from the bedplate's reaction.",
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key, as motion.duration=20."),
]
Weld = Annotated[bool, typer.Option("--weld-root", help="Weld a floating root to the bedplate.")]
Lock = Annotated[
    list[str] | None,
    typer.Option(
        "--lock",
        metavar="JOINT[=q]",
        help="Hold a joint at q [rad or m], or where it rests; again for more.",
    ),
]
LockMimic = Annotated[
    bool, typer.Option("--lock-mimic", help="Hold all joints that follow others.")
]
Accept = Annotated[
    bool, typer.Option("--accept-inertia", help="Take impossible inertias with a warning.")
]
Zeros = Annotated[
    bool, typer.Option("--zeros", help="Parameters that are zero in the model file are known.")
]
Zero = Annotated[
    list[str] | None,
    typer.Option("--zero", metavar="NAME", help="A parameter known to be zero, as mb1x."),
]
Gravity = Annotated[
    tuple[float, float, float] | None,
    typer.Option(help="Gravity vector [m/s^2]; default the recording's or the model file's."),
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF or URDF file.")]


def lock_of(model: Path, lock: list[str] | None, lock_mimic: bool) -> dict[str, float | None]:
    """What --lock and --lock-mimic hold of a model."""
    from testbed.robot.load import mimic_joints
    from testbed.robot.locks import parse_lock

    held = parse_lock(lock or ())
    return dict.fromkeys(mimic_joints(model)) | held if lock_mimic else held


def note(lines: Iterable[str]) -> None:
    """Say on standard error what a person should know, a line each."""
    for line in lines:
        typer.echo(f"note: {line}", err=True)
