"""Commands for simulated experiments: run, simulate, campaign."""

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
    print_notes,
    settings_with_gravity,
)
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import count_with_noun
from testbed.core.base.installation import user_or_shipped_file

if TYPE_CHECKING:
    from testbed.core.base.arrays import Array
    from testbed.core.recordings.recording import Truth
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.simulation.rollout import BlockCallback


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
            "--live",
            help="Show the recording in an open viewer: rerun --bind 127.0.0.1",
        ),
    ] = False,
    everything: Everything = False,
    as_json: Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    Sensor errors are added by
    --set 'measurement.fault=[{kind="plate_bias"}, {kind="encoder_zero_error"}]'. `testbed list`
    prints the kinds.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.core.base.errors import RecordingError
    from testbed.lab.experiment.carry_out import carry_out
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.experiment.results import check_folder, default_folder, run_result
    from testbed.view import output, terminal

    experiment = Experiment.from_toml(file, settings_with_gravity(settings, gravity))
    folder = out or default_folder(experiment)
    # repeating the same run needs no --force
    check_outputs(folder, force=True, folder=True)
    check_folder(folder, experiment, force=force)
    watch = _live_view(experiment) if live else _ignore_sample
    completed_run = carry_out(
        experiment, watch=watch, folder=folder, stage=output.Progress
    )
    if as_json:
        output.print_json(
            run_result(completed_run).document() | {"folder": str(folder)}
        )
    elif completed_run.estimates:
        terminal.print_run(completed_run, folder, everything=everything)
    if not completed_run.estimates:
        reasons = "; ".join(
            f"{method}: {error}" for method, error in completed_run.failures.items()
        )
        raise RecordingError(
            f"the recording is kept in '{folder}', but no estimate: {reasons}"
        )
    raise typer.Exit(0 if completed_run.as_expected else 1)


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
    experiment = Experiment.from_toml(file, settings_with_gravity(settings, gravity))
    with output.Progress("simulating") as progress:
        recording = record(experiment, progress)
    recording.save(out)
    output.console().print(
        f"{count_with_noun(recording.samples, 'sample')} at {recording.rate:g} Hz in {out}"
    )


def _ignore_sample(time: Array, truth: Truth) -> None:
    """Ignore simulated samples; the callback used without --live."""


def _live_view(experiment: Experiment) -> BlockCallback:
    """Callback that sends simulated samples to an open Rerun viewer.

    Diagnostics of the meshes in the robot's model are printed as notes.
    """
    from testbed.bodies.shapes.appearance import load_appearance
    from testbed.lab.experiment.rig import robot_of
    from testbed.view.viewer.live import LiveViewer

    appearance = load_appearance(robot_of(experiment), experiment.file)
    print_notes(sentences(appearance.diagnostics))
    return LiveViewer(experiment.name, appearance)


@command()
def campaign(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml",
            parser=user_or_shipped_file,
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
        int | None, typer.Option(min=1, help="Largest number of runs.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Only summarise a campaign folder.")
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Number of processes; default one per processor; 0: none but this one.",
        ),
    ] = None,
) -> None:
    """Carry out many runs of an experiment: factors, replicates, one table.

    Repeating the command carries out missing and failed runs. A failed run is a row of the table
    with the command that repeats it; exit code 1 if there is one.

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
    from testbed.campaigns.results import RESULTS_FILE, read_campaign_results
    from testbed.view import output

    if summary:
        path = file if file.is_file() else file / RESULTS_FILE
    else:
        plan = Campaign.load(file, settings or ())
        folder = out or Path("runs") / f"{plan.tables.name}-campaign"
        if dry_run:
            print_plan(output.console(), plan)
            return
        path = folder / RESULTS_FILE
        check_outputs(path, force=True, read=(file, plan.experiment_file))
        count = len(os.sched_getaffinity(0)) if workers is None else workers
        with output.Progress("runs") as progress:
            conduct(plan, folder, count, limit, progress)
    results = read_campaign_results(path)
    print_campaign(output.console(), results)
    write_campaign_page(path.with_name("summary.html"), results)
    raise typer.Exit(1 if results.failures else 0)
