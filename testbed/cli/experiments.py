"""Commands about runs and recordings: run, compare, simulate, identify, validate and others."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.consistent_files import (
    ConsistentBodies,
    Fixed,
    FixedLinks,
    InPlace,
    Write,
    Writing,
)
from testbed.cli.options import (
    Accept,
    Gravity,
    Json,
    Lock,
    LockMimic,
    Plate,
    RecordingSet,
    Set,
    Threads,
    Unchecked,
    Weld,
    Zeros,
    app,
    note,
)
from testbed.cli.reading import Reading, corrected_source

if TYPE_CHECKING:
    from testbed.arrays import Array
    from testbed.experiment.experiment import Experiment
    from testbed.identification.estimate import Estimate, Method
    from testbed.recordings.recording import Truth
    from testbed.recordings.source import Source
    from testbed.simulation.rollout import Watch


class _Method(StrEnum):
    external = "external"
    internal = "internal"
    both = "both"


@app.command()
def run(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Experiment file.")],
    settings: Set = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default runs/NAME-HASH.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a run of another experiment.")
    ] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show it in an open viewer: rerun --bind 127.0.0.1")
    ] = False,
    as_json: Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    What may be wrong with the instruments, as `testbed faults` lists it, is added by
    --set 'measurement.fault=[{kind="plate_bias"}, {kind="encoder_zero_error"}]'.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.errors import RecordingError
    from testbed.experiment.carry_out import checked_elsewhere
    from testbed.experiment.evaluate import evaluate
    from testbed.experiment.experiment import Experiment
    from testbed.experiment.results import result
    from testbed.experiment.run_folder import (
        check_folder,
        default_folder,
        write_recorded,
        write_result,
    )
    from testbed.experiment.simulate import simulate as simulated
    from testbed.report import terminal

    experiment = Experiment.load(file, settings or ())
    folder = out or default_folder(experiment)
    check_folder(folder, experiment, force=force)
    watch = _watcher(experiment) if live else _unwatched
    with terminal.Progress("simulating") as progress:
        recording = simulated(experiment, progress, watch)
    write_recorded(experiment, recording, folder)
    with terminal.Progress("identifying") as progress:
        done = evaluate(experiment, recording, progress)
    with terminal.Progress("validating on an unseen motion") as progress:
        done, _ = checked_elsewhere(done, progress)
    write_result(done, folder)
    if as_json:
        terminal.print_json(result(done) | {"folder": str(folder)})
    elif done.estimates:
        terminal.print_run(done, folder)
    if not done.estimates:
        reasons = "; ".join(f"{method}: {said}" for method, said in done.failures.items())
        raise RecordingError(f"the recording is kept in '{folder}', but no estimate: {reasons}")
    raise typer.Exit(0 if done.as_expected else 1)


@app.command()
def compare(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Comparison file.")],
    settings: Set = None,
    as_json: Json = False,
) -> None:
    """Simulate once; measure and identify in several ways, without and with a remedy.

    Example: testbed compare experiments/faults.toml --set motion.duration=20
    """
    from testbed.experiment.comparison import Comparison, comparison_as_json
    from testbed.experiment.comparison import compare as compared
    from testbed.report import terminal
    from testbed.report.comparison_table import print_comparison

    comparison = Comparison.load(file, settings or ())
    with terminal.Progress("comparing") as progress:
        rows = list(compared(comparison, progress))
    if as_json:
        terminal.print_json(comparison_as_json(comparison, rows))
    else:
        print_comparison(terminal.console(), comparison, rows)
    raise typer.Exit(0 if all(row.as_expected for row in rows) else 1)


@app.command()
def simulate(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Experiment file.")],
    out: Annotated[Path, typer.Option(help="Recording to write (Parquet).")],
    settings: Set = None,
) -> None:
    """Simulate an experiment and write only its recording.

    Example: testbed simulate experiments/table6.toml --out recording.parquet
    """
    from testbed.experiment.experiment import Experiment
    from testbed.experiment.simulate import simulate as simulated
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
    settings: RecordingSet = None,
    method: Annotated[_Method, typer.Option(help="Which estimates to make.")] = _Method.both,
    zeros: Zeros = False,
    gravity: Gravity = None,
    weld_root: Weld = False,
    accept_inertia: Accept = False,
    lock: Lock = None,
    lock_mimic: LockMimic = False,
    plate: Plate = None,
    consistent: ConsistentBodies = False,
    write: Write = None,
    fixed: FixedLinks = Fixed.lump,
    in_place: InPlace = False,
    unchecked: Unchecked = False,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Identify the minimal parameters from a recording, by bedplate and by torques.

    The recording may be larger than memory. A method whose signal it lacks is left out. One that
    was imported is held against the model first: signs, units, order, zeros, clocks.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros

    Example: testbed identify recording.parquet --model robot.urdf --write identified.urdf
    """
    from testbed.experiment.consistent_results import consistent_as_json
    from testbed.experiment.results import identified_as_json
    from testbed.identification.cross_check import warnings_between
    from testbed.identification.estimate import METHODS, SIGNAL_OF
    from testbed.identification.identify import identify as identified
    from testbed.report import terminal

    reading = Reading(settings, zeros, weld_root, accept_inertia, lock, lock_mimic, plate)
    writing = Writing(consistent, write, fixed, in_place)
    writing.check(reading, model)
    table, tree = reading.tables().identification, reading.tree(model)
    source, doubt = reading.source(recording, tree), reading.doubt(tree)
    accepted = reading.accepted(source, tree, unchecked=unchecked)
    wanted = METHODS if method is _Method.both else (METHODS[list(_Method).index(method)],)
    there = [name for name in wanted if SIGNAL_OF[name] in source.signals]
    lacking = [name for name in wanted if name not in there]
    warnings = [f"the recording has no {SIGNAL_OF[m]}: no {m} estimate" for m in lacking]
    warnings += accepted

    def estimate_of(part: Source, name: Method) -> Estimate:
        """By one method, of the recording or of a part of it."""
        how: dict[str, Any] = {
            "gravity": gravity,
            "settings": table,
            "doubt": doubt,
            "threads": threads,
        }
        with terminal.Progress(f"identifying, {name}") as progress:
            return identified(tree, part, name, progress=progress, **how)

    estimates = [estimate_of(source, name) for name in there or wanted]  # the first says what lacks
    bodies = None
    if writing.wanted:
        bodies = writing.bodies(reading, model, source, estimates, estimate_of)
        warnings += [*bodies.warnings, *writing.written(bodies, reading, model, recording)]
    if as_json:
        content = identified_as_json(estimates, reading.model_file(model), reading.tables())
        if bodies is not None:
            content["consistent"] = consistent_as_json(bodies)
        terminal.print_json(content)
    else:
        warnings += warnings_between(estimates)
        terminal.print_estimates(estimates, [*tree.warnings, *warnings], bodies)
        if write is not None:
            terminal.print_lines([f"model file: {write}"], ())


@app.command()
def validate(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="Of another motion (Parquet).")
    ],
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="What identify --json printed, or a run folder (result)."
        ),
    ],
    model: Annotated[
        Path | None, typer.Option(help="Where the model file is now; default as the result says.")
    ] = None,
    gravity: Gravity = None,
    settings: RecordingSet = None,
    plate: Plate = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Hold estimates against a recording of a motion that they have not seen.

    Residuals stand beside the noise that the estimate found in its own recording and what the
    parameters' sigma adds; above twice what both make together there is a warning.

    Example: testbed validate other.parquet runs/table6-286a25ef
    """
    from testbed.errors import RecordingError
    from testbed.experiment.read_result import read_result
    from testbed.experiment.results import validation_as_json
    from testbed.identification.estimate import SIGNAL_OF
    from testbed.identification.validate import validate as validated
    from testbed.recordings.source import open_source
    from testbed.report import terminal

    kept = read_result(result, model, settings or ())
    source = corrected_source(open_source(recording), kept.tree, plate)
    there = [e for e in kept.estimates if SIGNAL_OF[e.method] in source.signals]
    warnings = [
        f"the recording has no {SIGNAL_OF[e.method]}: the {e.method} estimate is not validated"
        for e in kept.estimates
        if e not in there
    ]
    if not there:
        raise RecordingError("; ".join(warnings))
    found = {}
    for estimate in there:
        with terminal.Progress(f"validating, {estimate.method}") as progress:
            found[estimate.method] = validated(
                kept.tree,
                source,
                estimate,
                gravity=gravity,
                settings=kept.settings,
                threads=threads,
                progress=progress,
            )
    if as_json:
        terminal.print_json({method: validation_as_json(each) for method, each in found.items()})
    else:
        terminal.print_validations(list(found.values()), warnings)


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
    from testbed.experiment.evaluate import model_of, robot_of
    from testbed.robot.visuals.appearance import load_appearance
    from testbed.viewer.live import Live

    look = load_appearance(robot_of(experiment), model_of(experiment))
    note(look.warnings)
    return Live(experiment.name, look)
