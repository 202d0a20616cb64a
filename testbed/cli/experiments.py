"""The commands run, simulate, warmup and campaign."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import (
    Everything,
    ExperimentFile,
    Force,
    Gravity,
    Json,
    Set,
    check_outputs,
    command,
    ending,
    note,
    with_gravity,
)
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import plural
from testbed.core.base.installation import own_or_shipped

if TYPE_CHECKING:
    from testbed.core.base.arrays import Array
    from testbed.core.recordings.recording import Truth
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.simulation.rollout import Watch


@command()
def run(
    file: ExperimentFile,
    settings: Set = None,
    gravity: Gravity = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder; default runs/NAME-HASH.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a run of another experiment.")
    ] = False,
    live: Annotated[
        bool,
        typer.Option(
            "--live", help="Show it in an open viewer: rerun --bind 127.0.0.1"
        ),
    ] = False,
    everything: Everything = False,
    as_json: Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    What may be wrong with the instruments is added by
    --set 'measurement.fault=[{kind="plate_bias"}, {kind="encoder_zero_error"}]'. `testbed list`
    has the kinds.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.core.base.errors import RecordingError
    from testbed.lab.experiment.carry_out import carry_out
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.experiment.results import check_folder, default_folder, result_of
    from testbed.view import output, terminal

    experiment = Experiment.from_toml(file, with_gravity(settings, gravity))
    folder = out or default_folder(experiment)
    # the same run again needs no --force
    check_outputs(folder, force=True, folder=True)
    check_folder(folder, experiment, force=force)
    watch = _watcher(experiment) if live else _unwatched
    done = carry_out(experiment, watch=watch, folder=folder, stage=output.Progress)
    if as_json:
        output.print_json(result_of(done).document() | {"folder": str(folder)})
    elif done.estimates:
        terminal.print_run(done, folder, everything=everything)
    if not done.estimates:
        reasons = "; ".join(
            f"{method}: {said}" for method, said in done.failures.items()
        )
        raise RecordingError(
            f"the recording is kept in '{folder}', but no estimate: {reasons}"
        )
    raise typer.Exit(0 if done.as_expected else 1)


@command()
def simulate(
    file: ExperimentFile,
    out: Annotated[
        Path,
        typer.Option(callback=ending(".parquet"), help="Recording to write (Parquet)."),
    ],
    settings: Set = None,
    gravity: Gravity = None,
    force: Force = False,
) -> None:
    """Simulate an experiment and write only its recording.

    Example: testbed simulate experiments/table6.toml --out recording.parquet
    """
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.experiment.record import record
    from testbed.view import output

    check_outputs(out, force=force, read=(file,))
    experiment = Experiment.from_toml(file, with_gravity(settings, gravity))
    with output.Progress("simulating") as progress:
        recording = record(experiment, progress)
    recording.save(out)
    output.console().print(
        f"{plural(recording.samples, 'sample')} at {recording.rate:g} Hz in {out}"
    )


def _unwatched(time: Array, truth: Truth) -> None:
    """Nobody looks."""


def _watcher(experiment: Experiment) -> Watch:
    """A view of the run in an open viewer."""
    from testbed.bodies.shapes.appearance import load_appearance
    from testbed.lab.experiment.rig import robot_of
    from testbed.view.viewer.live import Live

    look = load_appearance(robot_of(experiment), experiment.file)
    note(sentences(look.diagnostics))
    return Live(experiment.name, look)


@command()
def campaign(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml",
            parser=own_or_shipped,
            help="Campaign file; with --summary its folder.",
        ),
    ],
    settings: Set = None,
    out: Annotated[
        Path | None, typer.Option(help="Campaign folder; default runs/NAME-campaign.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List cells, count runs.")
    ] = False,
    limit: Annotated[
        int | None, typer.Option(min=1, help="At most so many runs.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Only summarise a campaign folder.")
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option(
            min=0, help="Processes; default one per processor, 0: only this one."
        ),
    ] = None,
) -> None:
    """Carry out many runs of an experiment: factors, replicates, one table.

    The same command again does what is missing, and what failed. A run that fails is a row of the
    table, with what makes it again; exit code 1 if there is one.

    Example: testbed campaign experiments/campaigns/coverage.toml --limit 20

    Example: testbed campaign --summary runs/coverage-campaign
    """
    from testbed.campaigns.campaign import Campaign
    from testbed.campaigns.campaign_section import (
        print_campaign,
        print_plan,
        write_campaign_page,
    )
    from testbed.campaigns.conduct import conduct
    from testbed.campaigns.results import RESULTS, read_results
    from testbed.view import output

    if summary:
        path = file if file.is_file() else file / RESULTS
    else:
        asked = Campaign.load(file, settings or ())
        folder = out or Path("runs") / f"{asked.tables.name}-campaign"
        if dry_run:
            print_plan(output.console(), asked)
            return
        path = folder / RESULTS
        check_outputs(path, force=True, read=(file, asked.base))
        count = len(os.sched_getaffinity(0)) if workers is None else workers
        with output.Progress("runs") as progress:
            conduct(asked, folder, count, limit, progress)
    results = read_results(path)
    print_campaign(output.console(), results)
    write_campaign_page(path.with_name("summary.html"), results)
    raise typer.Exit(1 if results.failures else 0)
