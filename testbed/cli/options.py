"""The application, and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from testbed.installation import own_or_shipped


def ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """A check of the name of a file to write: it says what will be in it.

    Args:
        endings: That the file may have, as ".html".
    """

    def checked(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            raise typer.BadParameter(f"'{path}': it is written as {' or '.join(endings)}")
        return path

    return checked


class Vector(NamedTuple):
    """Three numbers with commas between them, as 0,0,-9.81."""

    x: float
    y: float
    z: float

    def __repr__(self) -> str:
        return f"{self.x:g} {self.y:g} {self.z:g}"

    @staticmethod
    def parse(word: str) -> Vector:
        """The numbers of a word."""
        try:
            x, y, z = map(float, word.split(","))
        except ValueError:
            raise typer.BadParameter(f"'{word}' is no vector; write it as 0,0,-9.81") from None
        return Vector(x, y, z)


def joined_vectors(words: list[str]) -> list[str]:
    """The command line's words, with `--gravity 0 0 -9.81` written as `--gravity 0,0,-9.81`."""
    found = list(words)
    for k, word in enumerate(words):
        if word == "--gravity" and len(words) > k + 3 and "," not in words[k + 1]:
            found[k + 1 : k + 4] = [",".join(words[k + 1 : k + 4])]
    return found


OUTPUT, ROBOT = "Output and speed", "Robot"
"""Groups of options in a command's help, after the common ones."""

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",  # paragraphs flow, words in [brackets] are words
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Identify the inertial parameters of a robot from joint torques or from a force plate "
    "under its base, simulated or real.",
)


def _version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        from testbed.installation import version

        typer.echo(f"testbed {version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del version  # its callback has done it


Json = Annotated[bool, typer.Option("--json", help="Print JSON.", rich_help_panel=OUTPUT)]
Everything = Annotated[
    bool,
    typer.Option(
        "--all", help="Print all parameters, warnings and residuals.", rich_help_panel=OUTPUT
    ),
]


def _timed(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        from testbed.reporting.output import printed_stages

        context.with_resource(printed_stages())
    return wanted


Timings = Annotated[
    bool,
    typer.Option(
        "--timings",
        callback=_timed,
        help="Print the CPU time of each stage.",
        rich_help_panel=OUTPUT,
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a key, e.g. motion.duration=20; repeatable."
    ),
]
RecordingSet = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a key, e.g. identification.cutoff=8; repeatable."
    ),
]
Terms = Annotated[
    str | None,
    typer.Option(
        metavar="TERM,...|auto",
        help="Joint terms, e.g. coulomb,viscous,rotor/elbow; auto: by cross-validation.",
    ),
]
Weld = Annotated[
    bool,
    typer.Option(
        "--weld-root", help="Weld a floating root to the bedplate.", rich_help_panel=ROBOT
    ),
]
Lock = Annotated[
    list[str] | None,
    typer.Option(
        "--lock",
        metavar="JOINT[=q]",
        help="Fix a joint at q [rad or m], default at its rest position; repeatable.",
        rich_help_panel=ROBOT,
    ),
]
LockMimic = Annotated[
    bool,
    typer.Option("--lock-mimic", help="Fix all joints that follow others.", rich_help_panel=ROBOT),
]
Unchecked = Annotated[
    bool,
    typer.Option("--unchecked", help="Skip the plausibility check of imported recordings."),
]
Plate = Annotated[
    Path | None, typer.Option(help="Calibration file of the plate, by testbed calibrate.")
]
Zeros = Annotated[
    bool,
    typer.Option("--zeros", help="Fix to zero all parameters that are zero in the model file."),
]
Zero = Annotated[
    list[str] | None,
    typer.Option("--zero", metavar="NAME", help="Fix a parameter to zero, e.g. mb1x; repeatable."),
]
Gravity = Annotated[
    Vector | None,
    typer.Option(
        metavar="X,Y,Z",
        parser=Vector.parse,
        help="Gravity [m/s^2]; default from the recording or the model file.",
        rich_help_panel=ROBOT,
    ),
]
Threads = Annotated[
    int | None, typer.Option(min=1, help="Default: one per processor.", rich_help_panel=OUTPUT)
]
Model = Annotated[
    Path, typer.Argument(metavar="MODEL", parser=own_or_shipped, help="MJCF or URDF file.")
]
RobotModel = Annotated[
    Path,
    typer.Option(
        "--model", metavar="PATH", parser=own_or_shipped, help="MJCF or URDF file of the robot."
    ),
]
ExperimentFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE.toml",
        parser=own_or_shipped,
        help="Experiment file, or the name of a shipped one.",
    ),
]


def note(lines: Iterable[str]) -> None:
    """Say on standard error what a person should know, a line each."""
    for line in lines:
        typer.echo(f"note: {line}", err=True)
