"""Application, shared option types of commands, and option groups as dataclasses."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import fields
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_type_hints

import typer

from testbed.core.base.errors import printable_line
from testbed.core.base.installation import user_or_shipped_file
from testbed.core.robot.gravity import GRAVITY_BY_MOUNTING, parse_gravity

Command = TypeVar("Command", bound=Callable[..., None])


def ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """Callback that checks the suffix of an output file.

    It returns the path, or raises BadParameter if the suffix is not allowed.

    Args:
        *endings: Allowed suffixes in lower case, such as ".html"; the case of the path's suffix is
            ignored.
    """

    def check_suffix(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            raise typer.BadParameter(
                f"'{path}': it is written as {' or '.join(endings)}"
            )
        return path

    return check_suffix


def check_outputs(
    *paths: Path | None,
    force: bool,
    folder: bool = False,
    read: Iterable[Path | None] = (),
) -> None:
    """Check that a command may write its outputs, before it does any work.

    Args:
        *paths: Files to write; None is ignored.
        force: True if existing files may be replaced.
        folder: True if the paths are folders.
        read: Input files, which are never replaced; None is ignored.

    Raises:
        BadParameter: A file exists, or a folder is not empty, and `force` is False.
        OSError: An output cannot be written, is also an input, or is given twice.
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


class GravityVector(NamedTuple):
    """Gravity given by --gravity, in the bedplate frame, (x, y, z) [m/s^2]."""

    x: float
    y: float
    z: float

    def __repr__(self) -> str:
        return f"{self.x:g} {self.y:g} {self.z:g}"

    @staticmethod
    def parse(word: str) -> GravityVector:
        """Parse the value of --gravity.

        Args:
            word: Three numbers such as 0,0,-9.81, or a mounting such as `wall +x`.

        Raises:
            BadParameter: The word is neither of these.
        """
        try:
            return GravityVector(*parse_gravity(word))
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None


def join_gravity_words(words: list[str]) -> list[str]:
    """Join the words of the first --gravity in command-line arguments to a single word.

    Joining two words is tried first, then three (`wall +x`, `0 0 -9.81`). Words that do not
    describe gravity are left unchanged.
    """
    start = [*words, "--gravity"].index("--gravity") + 1
    for end in (start + 2, start + 3):
        joined = " ".join(words[start:end])
        with suppress(ValueError):
            parse_gravity(joined)
            return [*words[:start], joined, *words[end:]]
    return words


OUTPUT, ROBOT = "Output and speed", "Robot"
"""Panels of options in a command's help, after the common options."""

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",  # joins lines of a paragraph, leaves [brackets] alone
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Identify the inertial parameters of a robot from joint torques or from a force plate "
    "under its base, simulated or real.",
)


class OptionFields:
    """Annotation that lists the fields of a dataclass that are options of a command.

    Attributes:
        names: Names of the fields, in the order of the help text.
        required: Annotated types of required options, keyed by field; these come first, and their
            type replaces type and default of the field.
    """

    def __init__(self, *names: str, **required: Any) -> None:
        self.names, self.required = (*required, *names), required

    def parameters(self, group: Any) -> list[Parameter]:
        """Keyword-only parameters for a signature, one per field in `names`.

        Args:
            group: Dataclass of the options.
        """
        defaults = {each.name: each.default for each in fields(group)}
        defaults |= dict.fromkeys(self.required, Parameter.empty)
        hints = get_type_hints(group, include_extras=True) | self.required
        return [_parameter(name, hints[name], defaults[name]) for name in self.names]


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    """Keyword-only parameter for a command's signature."""
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def command(name: str | None = None) -> Callable[[Command], Command]:
    """Decorator that registers a function as a command and expands its option groups.

    A parameter annotated with `OptionFields` is a dataclass. The listed fields become separate
    options, from which the command builds the dataclass. The function itself is returned unchanged.

    Args:
        name: Name of the command; default the function's name.
    """

    def register(function: Command) -> Command:
        hints = get_type_hints(function, include_extras=True)
        groups: dict[str, tuple[Any, OptionFields]] = {}
        parameters: list[Parameter] = []
        for each in signature(function).parameters.values():
            hint = hints[each.name]
            kind, *metadata = get_args(hint) or (None,)
            if metadata and isinstance(metadata[0], OptionFields):
                groups[each.name] = kind, metadata[0]
                parameters += metadata[0].parameters(kind)
            else:
                parameters.append(_parameter(each.name, hint, each.default))

        @wraps(function)
        def flat_function(**values: Any) -> None:
            for group, (kind, group_fields) in groups.items():
                values[group] = kind(
                    **{each: values.pop(each) for each in group_fields.names}
                )
            function(**values)

        flat_function.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        flat_function.__annotations__ = {
            each.name: each.annotation for each in parameters
        }
        app.command(name)(flat_function)
        return function

    return register


def _print_version(requested: bool) -> None:
    """Print the version and exit; callback of --version."""
    if requested:
        from testbed.core.base.installation import installed_version

        typer.echo(f"testbed {installed_version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the version.",
        ),
    ] = False,
) -> None:
    """Options before the command: --version."""
    del version  # handled by the callback


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


def _enable_timings(context: typer.Context, enabled: bool) -> bool:
    """Print the CPU times of stages at the end of the command; callback of --timings."""
    if enabled:
        from testbed.view.output import print_stage_times

        context.with_resource(print_stage_times())
    return enabled


Timings = Annotated[
    bool,
    typer.Option(
        "--timings",
        callback=_enable_timings,
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
    typer.Option("--force", help="Replace existing files.", rich_help_panel=OUTPUT),
]
Model = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL", parser=user_or_shipped_file, help="MJCF or URDF file."
    ),
]
Gravity = Annotated[
    GravityVector | None,
    typer.Option(
        "--gravity",
        metavar="X,Y,Z|WORD",
        parser=GravityVector.parse,
        help=f"Gravity [m/s^2] in the base's axes, or {', '.join(GRAVITY_BY_MOUNTING)}; "
        "goes before what recording, experiment and model file say.",
        rich_help_panel=ROBOT,
    ),
]


def settings_with_gravity(
    settings: list[str] | None, gravity: GravityVector | None
) -> list[str]:
    """Settings of --set, followed by --gravity in the form "gravity=[x, y, z]".

    Args:
        settings: Values of --set; None for none.
        gravity: Value of --gravity; None to keep the gravity of the experiment.
    """
    gravity_setting = [] if gravity is None else [f"gravity={[*gravity]}"]
    return [*(settings or ()), *gravity_setting]


RobotModel = Annotated[
    Path,
    typer.Option(
        "--model",
        metavar="PATH",
        parser=user_or_shipped_file,
        help="MJCF or URDF file of the robot.",
    ),
]
ExperimentFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE.toml",
        parser=user_or_shipped_file,
        help="Experiment file, or the name of a shipped one.",
    ),
]


def print_notes(lines: Iterable[str]) -> None:
    """Print notes on standard error, one per line."""
    for line in lines:
        typer.echo(printable_line(f"note: {line}"), err=True)
