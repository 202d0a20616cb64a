"""Commands about runs and recordings: run, simulate, identify, warmup."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from testbed.cli.options import Accept, Gravity, Json, Set, Weld, Zeros, app

if TYPE_CHECKING:
    from testbed.arrays import Array
    from testbed.experiment.experiment import Experiment
    from testbed.recordings.recording import Truth
    from testbed.simulation.rollout import Watch


class _Method(StrEnum):
    external = "external"
    internal = "internal"
    both = "both"


class _Weights(StrEnum):
    channels = "channels"
    full = "full"


@app.command()
def run(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Experiment file.")],
    settings: Set = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default runs/NAME-HASH.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Show it in an open viewer: rerun --bind 127.0.0.1")
    ] = False,
    as_json: Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.experiment.carry_out import carry_out
    from testbed.experiment.experiment import Experiment
    from testbed.experiment.run_folder import check_folder, result, run_folder, write_run
    from testbed.report import terminal

    experiment = Experiment.load(file, settings or ())
    if out is not None:
        check_folder(out)
    watch = _watcher(experiment) if live else _unwatched
    with terminal.Progress("simulating") as progress:
        outcome = carry_out(experiment, progress, watch)
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
    settings: Set = None,
) -> None:
    """Simulate an experiment and write only its recording.

    Example: testbed simulate experiments/table6.toml --out recording.parquet
    """
    from testbed.experiment.carry_out import simulate as simulated
    from testbed.experiment.experiment import Experiment
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
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    accept_inertia: Accept = False,
    position_cutoff: Annotated[str, typer.Option(help="Low-pass on encoders [Hz], or off.")] = "40",
    cutoff: Annotated[str, typer.Option(help="Parallel low-pass [Hz], or off.")] = "5",
    deadband: Annotated[float, typer.Option(help="Slower joint rows are dropped.")] = 0.02,
    term: Annotated[
        list[str] | None,
        typer.Option(help="In a joint's torque besides the robot; again for more."),
    ] = None,
    weights: Annotated[_Weights, typer.Option(help="Noise: each channel's, or all together.")] = (
        _Weights.channels
    ),
    threads: Annotated[int | None, typer.Option(min=1, help="Default one a processor.")] = None,
    as_json: Json = False,
) -> None:
    """Identify the minimal parameters from a recording, by bedplate and by torques.

    The recording may be larger than memory.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros
    """
    from testbed.experiment.run_folder import estimate_as_json
    from testbed.identification.identify import identify as identified
    from testbed.identification.settings import Settings
    from testbed.report import terminal
    from testbed.robot.load import load_tree

    tree = load_tree(model, weld_root=weld_root, accept_inertia=accept_inertia)
    treatment = Settings(
        zeros=zeros,
        position_cutoff=_hertz(position_cutoff),
        cutoff=_hertz(cutoff),
        deadband=deadband,
        terms=tuple(term or Settings.terms),
        weights=weights.value,
    )
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
                gravity=gravity,
                settings=treatment,
                threads=threads,
                progress=progress,
            )
        estimates.append(estimate)
    if as_json:
        terminal.print_json({e.method: estimate_as_json(e) for e in estimates})
    else:
        terminal.print_estimates(estimates, tree.warnings)


@app.command()
def warmup() -> None:
    """Compile the fast kernel ahead of its first use.

    Example: testbed warmup
    """
    from testbed.kernel.numba_engine import warm_up
    from testbed.report import terminal

    with terminal.Progress("compiling"):
        folder = warm_up()
    terminal.console().print(f"compiled; kept in {folder}", soft_wrap=True)


def _unwatched(time: Array, truth: Truth) -> None:
    """Nobody looks."""


def _watcher(experiment: Experiment) -> Watch:
    """A view of the run in an open viewer."""
    from testbed.experiment.carry_out import robot_of
    from testbed.robot.visuals.load_shapes import load_shapes
    from testbed.viewer.live import Live, nothing_yet
    from testbed.viewer.story import tell

    tree = robot_of(experiment)
    shapes = load_shapes(experiment.model, tree, weld_root=experiment.weld_root)
    return Live(tell(experiment.name, tree, nothing_yet(tree.names), shapes))


def _hertz(text: str) -> float | None:
    """A cutoff as typed: a number, or off."""
    from testbed.errors import SettingsError

    if text == "off":
        return None
    try:
        return float(text)
    except ValueError:
        raise SettingsError(f"a cutoff is a frequency [Hz] or off, found '{text}'") from None
