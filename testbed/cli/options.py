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
    """Callback that returns the path of an output file, or raises BadParameter for its suffix.

    Args:
        *endings: Allowed suffixes in lower case, such as ".html"; case of the path is ignored.
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
    """Check, before the work, that a command may write its outputs.

    Args:
        *paths: Files to write; None is skipped.
        force: True to replace existing files.
        folder: True if the paths are folders.
        read: Input files, which are never replaced; None is skipped.

    Raises:
        BadParameter: A file exists, or a folder is not empty, and `force` is False.
        OSError: An output cannot be written, is an input, or occurs twice.
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
    """Gravity of --gravity in the bedplate frame, (x, y, z) [m/s^2]."""

    x: float
    y: float
    z: float

    def __repr__(self) -> str:
        return f"{self.x:g} {self.y:g} {self.z:g}"

    @staticmethod
    def parse(word: str) -> GravityVector:
        """Parse gravity from the value of --gravity.

        Args:
            word: Three numbers, such as 0,0,-9.81, or a mounting such as `wall +x`.

        Raises:
            BadParameter: The word is neither.
        """
        try:
            return GravityVector(*parse_gravity(word))
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None


def join_gravity_words(words: list[str]) -> list[str]:
    """Command-line arguments with the words after the first --gravity joined to one.

    Two words are tried, then three (`wall +x`, `0 0 -9.81`); words that are no gravity are left
    unchanged.
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
    """Annotation of a parameter: which fields of its dataclass are options of the command.

    Attributes:
        names: Names of the fields, in the order of the help.
        required: Annotated types of options that must be given, by field; these come first and
            replace type and default of the field.
    """

    def __init__(self, *names: str, **required: Any) -> None:
        self.names, self.required = (*required, *names), required

    def parameters(self, group: Any) -> list[Parameter]:
        """Keyword-only parameters of a signature, one per field in `names`.

        Args:
            group: Dataclass of the options.
        """
        defaults = {each.name: each.default for each in fields(group)}
        defaults |= dict.fromkeys(self.required, Parameter.empty)
        hints = get_type_hints(group, include_extras=True) | self.required
        return [_parameter(name, hints[name], defaults[name]) for name in self.names]


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    """Keyword-only parameter of a command's signature."""
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def command(name: str | None = None) -> Callable[[Command], Command]:
    """Decorator that registers a function as a command, with option groups expanded.

    A parameter annotated by `OptionFields` is a dataclass; the fields named there become separate
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
    """Print the version and exit, for --version."""
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
    """Print the CPU times of stages at the end of the command, for --timings."""
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
    """Settings of --set, followed by --gravity as a setting "gravity=[x, y, z]".

    Args:
        settings: Values of --set; None for none.
        gravity: Value of --gravity; None for the experiment's gravity.
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
