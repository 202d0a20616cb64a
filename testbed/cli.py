"""The command line: parses, calls, prints.

Exit codes: 0 done and as expected; 1 done, but a claim of [expect] failed; 2 the input is
at fault, with one message on standard error.
"""

from __future__ import annotations

import json
import sys
import warnings
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from testbed.errors import TestbedError

if TYPE_CHECKING:
    from rich.console import Console

    from testbed.identification.identify import Estimate

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="A virtual force plate under a robot: minimal dynamic parameters from joint torques "
    "and from the bedplate's reaction.",
)

_Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
_Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key, as motion.duration=20."),
]
_Weld = Annotated[bool, typer.Option("--weld-root", help="Weld a floating root to the bedplate.")]
_Accept = Annotated[
    bool, typer.Option("--accept-inertia", help="Take impossible inertias with a warning.")
]
_Zeros = Annotated[
    bool, typer.Option("--zeros", help="Parameters that are zero in the model file are known.")
]
_Gravity = Annotated[
    tuple[float, float, float] | None,
    typer.Option(help="Gravity vector [m/s^2]; default the recording's or the model file's."),
]
_Model = Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF or URDF file.")]


class _Method(StrEnum):
    external = "external"
    internal = "internal"
    both = "both"


@app.command()
def run(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Experiment file.")],
    settings: _Set = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default runs/NAME-HASH.")] = None,
    as_json: _Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.campaign.archive import check_folder, result, run_folder, write_run
    from testbed.campaign.carry_out import carry_out
    from testbed.campaign.experiment import Experiment

    experiment = Experiment.load(file, settings or ())
    if out is not None:
        check_folder(out)
    with _Progress("simulating") as progress:
        outcome = carry_out(experiment, progress)
    folder = out or run_folder(experiment)
    write_run(outcome, folder)
    if as_json:
        _print_json(result(outcome) | {"folder": str(folder)})
    else:
        _print_outcome(outcome, folder)
    raise typer.Exit(0 if outcome.as_expected else 1)


@app.command()
def simulate(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Experiment file.")],
    out: Annotated[Path, typer.Option(help="Recording to write (Parquet).")],
    settings: _Set = None,
) -> None:
    """Simulate an experiment and write only its recording.

    Example: testbed simulate experiments/table6.toml --out recording.parquet
    """
    from testbed.campaign.carry_out import simulate as simulated
    from testbed.campaign.experiment import Experiment

    experiment = Experiment.load(file, settings or ())
    with _Progress("simulating") as progress:
        recording = simulated(experiment, progress)
    recording.save(out)
    _console().print(f"{recording.samples} samples at {recording.rate:g} Hz in {out}")


@app.command()
def identify(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Parquet file.")],
    model: Annotated[Path, typer.Option(help="MJCF or URDF file of the robot.")],
    method: Annotated[_Method, typer.Option(help="Which estimates to make.")] = _Method.both,
    zeros: _Zeros = False,
    gravity: _Gravity = None,
    weld_root: _Weld = False,
    accept_inertia: _Accept = False,
    position_cutoff: Annotated[str, typer.Option(help="Low-pass on encoders [Hz], or off.")] = "40",
    cutoff: Annotated[str, typer.Option(help="Parallel low-pass [Hz], or off.")] = "5",
    deadband: Annotated[float, typer.Option(help="Slower joint rows are dropped.")] = 0.02,
    as_json: _Json = False,
) -> None:
    """Identify the minimal parameters from a recording, by bedplate and by torques.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros
    """
    from testbed.campaign.archive import estimate_as_json
    from testbed.identification.identify import identify as identified
    from testbed.identification.pipeline import Pipeline
    from testbed.measurement.recording import Recording
    from testbed.tree.load import load_tree

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    data = Recording.load(recording)
    pipeline = Pipeline(_hertz(position_cutoff), _hertz(cutoff), deadband)
    names: tuple[Literal["external", "internal"], ...] = ("external", "internal")
    estimates = [
        identified(tree, data, name, zeros=zeros, gravity=gravity, pipeline=pipeline)
        for name in names
        if method in (name, _Method.both)
    ]
    if as_json:
        _print_json({e.method: estimate_as_json(e) for e in estimates})
    else:
        _print_estimates(estimates, tree.doubts)


@app.command()
def minimal(
    model: _Model,
    zeros: _Zeros = False,
    zero: Annotated[
        list[str] | None,
        typer.Option("--zero", metavar="NAME", help="A parameter known to be zero, as mb1x."),
    ] = None,
    gravity: _Gravity = None,
    tared: Annotated[
        bool, typer.Option("--tared", help="The bedplate's static wrench has been taken off.")
    ] = False,
    show_map: Annotated[
        bool, typer.Option("--map", help="Show what each instrument tells of each parameter.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--verify", help="Hold the sets against two other witnesses.")
    ] = False,
    numbers: Annotated[
        bool, typer.Option("--numbers", help="Print the model's lengths as numbers.")
    ] = False,
    as_latex: Annotated[bool, typer.Option("--latex", help="Print the formulas in LaTeX.")] = False,
    weld_root: _Weld = False,
    accept_inertia: _Accept = False,
    as_json: _Json = False,
) -> None:
    """Print what joint torques and what the bedplate can tell about a robot.

    Example: testbed minimal models/puma562.urdf --zeros --map --verify
    """
    from testbed.dynamics.rank import verify
    from testbed.parameters.identifiability import identifiability
    from testbed.parameters.minimal_set import minimal_set
    from testbed.report.minimal import as_document, print_sets
    from testbed.tree.load import load_tree

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    known: bool | list[str] = list(zero) if zero else zeros
    dynamic = minimal_set(tree, "dynamic", gravity, known)
    reaction = minimal_set(tree, "reaction", gravity, known, tared)
    agreements = []
    if check:  # known zeros are struck out afterwards: the rules are verified without them
        general = minimal_set(tree, "reaction", gravity, tared=tared)
        agreements = [
            verify(tree, each) for each in (minimal_set(tree, "dynamic", gravity), general)
        ]
    seen = identifiability(tree, gravity, known) if show_map or as_json else ()
    if as_json:
        _print_json(as_document(tree, dynamic, reaction, seen, agreements))
    else:
        console = _console()
        _print_doubts(console, tree.doubts)
        lengths: Literal["symbols", "numbers"] = "numbers" if numbers else "symbols"
        print_sets(console, tree, dynamic, reaction, seen, agreements, lengths, as_latex)
    raise typer.Exit(0 if all(each.holds for each in agreements) else 1)


def main() -> None:
    """Run a command; what the user got wrong is one line and exit code 2."""
    warnings.simplefilter("ignore")  # numerical doubt is a field of the result
    try:
        code = app(standalone_mode=False)
    except TestbedError as error:
        _fail(str(error))
    except OSError as error:  # a full disk, a folder that may not be written
        _fail(str(error))
    except MemoryError:
        _fail("not enough memory; make the run shorter")
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write("testbed: interrupted\n")
        sys.exit(130)
    except Exception as error:
        message = getattr(error, "format_message", None)  # what the option parser found
        if message is None:
            raise
        _fail(f"{message()} (testbed --help tells more)")
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> NoReturn:
    sys.stderr.write(f"testbed: {' '.join(message.split())}\n")
    sys.exit(2)


def _hertz(text: str) -> float | None:
    """A cutoff as typed: a number, or off."""
    from testbed.errors import PipelineError

    if text == "off":
        return None
    try:
        return float(text)
    except ValueError:
        raise PipelineError(f"a cutoff is a frequency [Hz] or off, found '{text}'") from None


class _Progress:
    """A progress bar on standard error, if that is a terminal."""

    def __init__(self, label: str) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self._bar = Progress(console=Console(stderr=True), transient=True)
        self._bar.disable = not sys.stderr.isatty()
        self._task = self._bar.add_task(label)

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)


def _console() -> Console:
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    return console if console.is_terminal else Console(markup=False, highlight=False, width=120)


def _print_json(value: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(value, indent=1, sort_keys=True) + "\n")


def _print_estimates(estimates: list[Estimate], doubts: tuple[str, ...]) -> None:
    from testbed.report.tables import estimate_table, quality_lines

    console = _console()
    console.print(estimate_table(estimates))
    for line in quality_lines(estimates):
        console.print(line, soft_wrap=True)
    _print_doubts(console, (*doubts, *(d for e in estimates for d in e.doubts)))


def _print_outcome(outcome: Any, folder: Path) -> None:
    from testbed.report.tables import quality_lines, result_table, truths_by_name

    console = _console()
    external, internal, compared = outcome.external, outcome.internal, outcome.comparison
    truths = truths_by_name(external, compared.external.truth) | truths_by_name(
        internal, compared.internal.truth
    )
    console.print(result_table(external, internal, truths, f"{outcome.experiment.name}"))
    for line in quality_lines((external, internal)):
        console.print(line, soft_wrap=True)
    _print_doubts(console, outcome.doubts)
    verdicts = outcome.verdicts
    for name, value in compared.metrics.items():
        claim = ""
        if name in verdicts:
            bound = outcome.experiment.expect[name].model_dump(exclude_none=True)
            wanted = ", ".join(f"{k.replace('_', ' ')} {v:g}" for k, v in bound.items())
            claim = f"  ({wanted}: {'holds' if verdicts[name] else 'FAILS'})"
        console.print(f"{name:30s} {value:9.3g}{claim}")
    console.print(f"run folder: {folder}", soft_wrap=True)


def _print_doubts(console: Console, doubts: tuple[str, ...]) -> None:
    for doubt in doubts:
        console.print(f"note: {doubt}", style="yellow", soft_wrap=True)


if __name__ == "__main__":
    main()
