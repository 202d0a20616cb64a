"""The command line: parses, calls, prints.

Exit codes: 0 done and as expected; 1 done, but a claim of [expect] failed; 2 the input is
at fault, with one message on standard error.
"""

from __future__ import annotations

import sys
import warnings
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer

from testbed.errors import TestbedError

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


class _Term(StrEnum):
    coulomb = "coulomb"
    viscous = "viscous"
    offset = "offset"
    rotor = "rotor"


class _Weights(StrEnum):
    channels = "channels"
    full = "full"


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
    from testbed.report import terminal

    experiment = Experiment.load(file, settings or ())
    if out is not None:
        check_folder(out)
    with terminal.Progress("simulating") as progress:
        outcome = carry_out(experiment, progress)
    folder = out or run_folder(experiment)
    write_run(outcome, folder)
    if as_json:
        terminal.print_json(result(outcome) | {"folder": str(folder)})
    else:
        terminal.print_outcome(outcome, folder)
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
    from testbed.report import terminal

    experiment = Experiment.load(file, settings or ())
    with terminal.Progress("simulating") as progress:
        recording = simulated(experiment, progress)
    recording.save(out)
    terminal.console().print(f"{recording.samples} samples at {recording.rate:g} Hz in {out}")


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
    term: Annotated[
        list[_Term] | None,
        typer.Option(help="In a joint's torque besides the robot; again for more."),
    ] = None,
    weights: Annotated[_Weights, typer.Option(help="Noise: each channel's, or all together.")] = (
        _Weights.channels
    ),
    threads: Annotated[int | None, typer.Option(min=1, help="Default one a processor.")] = None,
    as_json: _Json = False,
) -> None:
    """Identify the minimal parameters from a recording, by bedplate and by torques.

    The recording may be larger than memory.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros
    """
    from testbed.campaign.archive import estimate_as_json
    from testbed.dynamics.kernel.layout import TERMS
    from testbed.identification.identify import identify as identified
    from testbed.identification.pipeline import Pipeline
    from testbed.report import terminal
    from testbed.tree.load import load_tree

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    terms = tuple(TERMS[list(_Term).index(t)] for t in term or (_Term.coulomb, _Term.viscous))
    pipeline = Pipeline(_hertz(position_cutoff), _hertz(cutoff), deadband, terms, weights.value)
    names: tuple[Literal["external", "internal"], ...] = ("external", "internal")
    estimates = []
    for name in names:
        if method not in (name, _Method.both):
            continue
        with terminal.Progress(f"identifying, {name}") as progress:
            estimate = identified(
                tree,
                recording,
                name,
                zeros=zeros,
                gravity=gravity,
                pipeline=pipeline,
                threads=threads,
                progress=progress,
            )
        estimates.append(estimate)
    if as_json:
        terminal.print_json({e.method: estimate_as_json(e) for e in estimates})
    else:
        terminal.print_estimates(estimates, tree.doubts)


@app.command()
def warmup() -> None:
    """Compile the fast kernel ahead of its first use.

    Example: testbed warmup
    """
    from testbed.dynamics.kernel.compiled import warm_up
    from testbed.report import terminal

    with terminal.Progress("compiling"):
        folder = warm_up()
    terminal.console().print(f"compiled; kept in {folder}", soft_wrap=True)


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
    from testbed.report import terminal
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
        terminal.print_json(as_document(tree, dynamic, reaction, seen, agreements))
    else:
        console = terminal.console()
        terminal.print_doubts(console, tree.doubts)
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


if __name__ == "__main__":
    main()
