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


app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",  # paragraphs flow, words in [brackets] are words
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="A virtual force plate under a robot: minimal dynamic parameters from joint torques "
    "and from the bedplate's reaction.",
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


Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
Everything = Annotated[
    bool, typer.Option("--all", help="Print all parameters and warnings, and how well data fit.")
]


def _timed(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        from testbed.reporting.output import printed_stages

        context.with_resource(printed_stages())
    return wanted


Timings = Annotated[
    bool, typer.Option(callback=_timed, help="Print the seconds of each stage on standard error.")
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key, as motion.duration=20."),
]
RecordingSet = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="As identification.cutoff=8, robot.lock.j=0."),
]
Terms = Annotated[
    str | None,
    typer.Option(
        metavar="TERM,...|auto",
        help="Of the joints' torques, as coulomb,viscous,rotor/elbow; auto: held-out data choose.",
    ),
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
Unchecked = Annotated[
    bool,
    typer.Option("--unchecked", help="Do not hold imported recordings against the model."),
]
Plate = Annotated[
    Path | None, typer.Option(help="The plate's file, as calibrate wrote it: it is corrected.")
]
Zeros = Annotated[
    bool, typer.Option("--zeros", help="Parameters that are zero in the model file are known.")
]
Zero = Annotated[
    list[str] | None,
    typer.Option("--zero", metavar="NAME", help="A parameter known to be zero, as mb1x."),
]
Gravity = Annotated[
    Vector | None,
    typer.Option(
        metavar="X,Y,Z",
        parser=Vector.parse,
        help="Gravity vector [m/s^2]; default the recording's or the model file's.",
    ),
]
Threads = Annotated[int | None, typer.Option(min=1, help="Default one a processor.")]
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
        help="Experiment file, or the name of one that came with testbed.",
    ),
]


def note(lines: Iterable[str]) -> None:
    """Say on standard error what a person should know, a line each."""
    for line in lines:
        typer.echo(f"note: {line}", err=True)
