"""Options of commands: the application, types that commands share, groups of them as values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import fields
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

import typer

from testbed.core.base.errors import printable
from testbed.core.base.installation import own_or_shipped
from testbed.core.robot.gravity import MOUNTINGS, gravity_of

Command = TypeVar("Command", bound=Callable[..., None])


def ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """A check of the name of a file to write: it says what will be in it.

    Args:
        endings: That the file may have, as ".html".
    """

    def checked(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            raise typer.BadParameter(
                f"'{path}': it is written as {' or '.join(endings)}"
            )
        return path

    return checked


def check_outputs(
    *paths: Path | None,
    force: bool,
    folder: bool = False,
    read: Iterable[Path | None] = (),
) -> None:
    """Check, before the work, that a command may write its outputs.

    Args:
        paths: Files to write; None for nothing.
        force: Whether what stands there is replaced.
        folder: Whether they are folders.
        read: Files that are read, and never replaced; None for nothing.

    Raises:
        BadParameter: Something stands there.
        OSError: As `check_writable`.
    """
    from testbed.core.base.files import check_writable

    check_writable(*paths, folder=folder, read=read)
    for path in paths:
        if (
            path is not None
            and not force
            and path.exists()
            and (not folder or any(path.iterdir()))
        ):
            raise typer.BadParameter(
                f"'{path}' is there and is not replaced; choose another name, or say --force"
            )


class Vector(NamedTuple):
    """Gravity by three numbers, as 0,0,-9.81, or by a word."""

    x: float
    y: float
    z: float

    def __repr__(self) -> str:
        return f"{self.x:g} {self.y:g} {self.z:g}"

    @staticmethod
    def parse(word: str) -> Vector:
        """The numbers of a word."""
        try:
            return Vector(*gravity_of(word))
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None


def joined_vectors(words: list[str]) -> list[str]:
    """The command line's words, those of `--gravity 0 0 -9.81` or `--gravity wall +x` as one."""
    first = [*words, "--gravity"].index("--gravity") + 1
    for last in (first + 2, first + 3):
        joined = " ".join(words[first:last])
        with suppress(ValueError):
            gravity_of(joined)
            return [*words[:first], joined, *words[last:]]
    return words


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


class Fields:
    """Fields of a dataclass that are options of a command, beside its type.

    Attributes:
        names: Of the fields, in the order of the help.
        required: Types of options that a command requires, by name; they come first.
    """

    def __init__(self, *names: str, **required: Any) -> None:
        self.names, self.required = (*required, *names), required

    def parameters(self, group: Any) -> list[Parameter]:
        """The options as parameters of a function.

        Args:
            group: The dataclass.
        """
        defaults = {each.name: each.default for each in fields(group)}
        defaults |= dict.fromkeys(self.required, Parameter.empty)
        hints = get_type_hints(group, include_extras=True) | self.required
        return [_parameter(name, hints[name], defaults[name]) for name in self.names]


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def command(name: str | None = None) -> Callable[[Command], Command]:
    """Make a function a command; a parameter annotated with `Fields` is a group of options.

    Args:
        name: Of the command; default the function's.
    """

    def registered(function: Command) -> Command:
        hints = get_type_hints(function, include_extras=True)
        groups: dict[str, tuple[Any, Fields]] = {}
        options: list[Parameter] = []
        for each in signature(function).parameters.values():
            hint = hints[each.name]
            kind, *metadata = get_args(hint) or (None,)
            if metadata and isinstance(metadata[0], Fields):
                groups[each.name] = kind, metadata[0]
                options += metadata[0].parameters(kind)
            else:
                options.append(_parameter(each.name, hint, each.default))

        @wraps(function)
        def flat(**values: Any) -> None:
            for group, (kind, chosen) in groups.items():
                values[group] = kind(
                    **{each: values.pop(each) for each in chosen.names}
                )
            function(**values)

        flat.__signature__ = Signature(options)  # type: ignore[attr-defined]
        flat.__annotations__ = {each.name: each.annotation for each in options}
        app.command(name)(flat)
        return function

    return registered


def _version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        from testbed.core.base.installation import version

        typer.echo(f"testbed {version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    del version  # its callback has done it


Json = Annotated[
    bool, typer.Option("--json", help="Print JSON.", rich_help_panel=OUTPUT)
]
Everything = Annotated[
    bool,
    typer.Option(
        "--all",
        help="Print all parameters, warnings and residuals.",
        rich_help_panel=OUTPUT,
    ),
]


def _timed(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        from testbed.view.output import printed_stages

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
        "--set",
        metavar="KEY=VALUE",
        help="Set a key, e.g. motion.duration=20; repeatable.",
    ),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Replace files that are there.", rich_help_panel=OUTPUT
    ),
]
Model = Annotated[
    Path,
    typer.Argument(metavar="MODEL", parser=own_or_shipped, help="MJCF or URDF file."),
]
Gravity = Annotated[
    Vector | None,
    typer.Option(
        "--gravity",
        metavar="X,Y,Z|WORD",
        parser=Vector.parse,
        help=f"Gravity [m/s^2] in the base's axes, or {', '.join(MOUNTINGS)}; goes before what "
        "recording, experiment and model file say.",
        rich_help_panel=ROBOT,
    ),
]


def with_gravity(settings: list[str] | None, gravity: Vector | None) -> list[str]:
    """Words of --set, and of --gravity as the last of them.

    Args:
        settings: Of an experiment.
        gravity: None for what the experiment says.
    """
    said = [] if gravity is None else [f"gravity={[*gravity]}"]
    return [*(settings or ()), *said]


RobotModel = Annotated[
    Path,
    typer.Option(
        "--model",
        metavar="PATH",
        parser=own_or_shipped,
        help="MJCF or URDF file of the robot.",
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
        typer.echo(printable(f"note: {line}"), err=True)
