"""The commands run, simulate, warmup and campaign."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.reading import (
    Everything,
    ExperimentFile,
    Force,
    Json,
    Set,
    app,
    check_outputs,
    ending,
    note,
)
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import plural
from testbed.core.base.installation import own_or_shipped

if TYPE_CHECKING:
    from testbed.campaigns.cluster import Tls
    from testbed.campaigns.conduct import Engine
    from testbed.core.base.arrays import Array
    from testbed.core.recordings.recording import Truth
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.simulation.rollout import Watch


@app.command()
def run(
    file: ExperimentFile,
    settings: Set = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default runs/NAME-HASH.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a run of another experiment.")
    ] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show it in an open viewer: rerun --bind 127.0.0.1")
    ] = False,
    everything: Everything = False,
    as_json: Json = False,
) -> None:
    """Carry out an experiment: simulate, identify, compare with the model file.

    What may be wrong with the instruments is added by
    --set 'measurement.fault=[{kind="plate_bias"}, {kind="encoder_zero_error"}]'. Kinds, of which
    `testbed list KIND` has more: encoder_instant_sampling, encoder_zero_error, encoder_gain,
    encoder_eccentricity, encoder_noise, encoder_resolution, torque_constant_error, torque_ripple,
    torque_offset, torque_noise, plate_gain, plate_crosstalk, plate_pose, plate_origin_height,
    plate_saturation, plate_converter, plate_anti_alias_filter, plate_delay, plate_clock_rate,
    plate_jitter, plate_dropped_samples, plate_bias, plate_drift, plate_random_walk, plate_noise,
    plate_coloured_noise, plate_pink_noise, plate_hum, measured_tare.

    Example: testbed run experiments/table6.toml --set motion.duration=20
    """
    from testbed.core.base.errors import RecordingError
    from testbed.lab.experiment.carry_out import carry_out
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.experiment.results import check_folder, default_folder, result_of
    from testbed.view import output, terminal

    experiment = Experiment.load(file, settings or ())
    folder = out or default_folder(experiment)
    check_outputs(folder, force=True, folder=True)  # the same run again needs no --force
    check_folder(folder, experiment, force=force)
    watch = _watcher(experiment) if live else _unwatched
    done = carry_out(experiment, watch=watch, folder=folder, stage=output.Progress)
    if as_json:
        output.print_json(result_of(done).document() | {"folder": str(folder)})
    elif done.estimates:
        terminal.print_run(done, folder, everything=everything)
    if not done.estimates:
        reasons = "; ".join(f"{method}: {said}" for method, said in done.failures.items())
        raise RecordingError(f"the recording is kept in '{folder}', but no estimate: {reasons}")
    raise typer.Exit(0 if done.as_expected else 1)


@app.command()
def simulate(
    file: ExperimentFile,
    out: Annotated[
        Path, typer.Option(callback=ending(".parquet"), help="Recording to write (Parquet).")
    ],
    settings: Set = None,
    force: Force = False,
) -> None:
    """Simulate an experiment and write only its recording.

    Example: testbed simulate experiments/table6.toml --out recording.parquet
    """
    from testbed.lab.experiment.experiment import Experiment
    from testbed.lab.experiment.record import record
    from testbed.view import output

    check_outputs(out, force=force, read=(file,))
    experiment = Experiment.load(file, settings or ())
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
    from testbed.lab.experiment.experiment_robot import model_of, robot_of
    from testbed.view.viewer.live import Live

    look = load_appearance(robot_of(experiment), model_of(experiment))
    note(sentences(look.diagnostics))
    return Live(experiment.name, look)


@app.command()
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
        bool, typer.Option("--dry-run", help="List and count the runs, estimate time and disk.")
    ] = False,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first runs.")] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Only summarise a campaign folder.")
    ] = False,
    against: Annotated[
        Path | None, typer.Option(help="With --summary: compare with this campaign's folder.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Local processes; default one per processor, 0: none."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Of a Dask cluster, as tcp://host:8786."),
    ] = None,
    tls_ca: Annotated[Path | None, typer.Option(help="Authority's certificate (PEM).")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="Own certificate (PEM).")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its key (PEM).")] = None,
) -> None:
    """Carry out many runs of an experiment: factors, replicates, one table.

    The same command again does what is missing. A run that fails is a row of the table, with what
    makes it again; exit code 1 if there is one.

    Example: testbed campaign experiments/campaigns/coverage.toml --limit 20

    Example: testbed campaign --summary runs/coverage-campaign
    """
    if summary or against is not None:
        _summary(file, against)
        return
    from testbed.campaigns.campaign import Campaign
    from testbed.campaigns.campaign_section import Throughput, print_conducted, print_plan
    from testbed.campaigns.conduct import conduct
    from testbed.campaigns.results import CAMPAIGN, LOCK
    from testbed.view import output

    asked = Campaign.load(file, settings or ())
    folder = out or Path("runs") / f"{asked.tables.name}-campaign"
    if dry_run:
        print_plan(output.console(), asked, folder, limit)
        return
    if not (folder / LOCK).exists():  # the folder's own file may ask for what is missing
        check_outputs(folder / CAMPAIGN, force=True, read=(file, asked.base))
    tls = _tls(tls_ca, tls_cert, tls_key)
    with _engine(workers, scheduler, tls) as engine, Throughput() as throughput:
        found = conduct(asked, folder, engine, limit, throughput.of)
    failures = print_conducted(output.console(), found)
    raise typer.Exit(1 if failures else 0)


def _summary(folder: Path, against: Path | None) -> None:
    """Print what a campaign says, and write it beside its table."""
    from testbed.campaigns.campaign_section import print_changes, print_summary, write_campaign_page
    from testbed.campaigns.summary import changes, read_campaign, summarise, write_summary
    from testbed.core.base.files import together
    from testbed.view import output

    with output.Progress("summarising"):
        found = summarise(read_campaign(folder))
    out, place = output.console(), folder if folder.is_dir() else folder.parent
    if against is not None:
        with output.Progress("summarising"):
            lines = list(changes(summarise(read_campaign(against)), found))
        print_changes(out, lines)
        return
    page = place / "summary.html"
    with output.Progress("drawing"), together():
        write_campaign_page(page, found)
        files = [page, *write_summary(found, place)]
    print_summary(out, found, files)


def _tls(authority: Path | None, certificate: Path | None, key: Path | None) -> Tls | None:
    """Files of an encrypted connection, all or none.

    Raises:
        BadParameter: One is missing, or is no file.
    """
    from testbed.campaigns.cluster import Tls

    if authority is None or certificate is None or key is None:
        if authority or certificate or key:
            raise typer.BadParameter("--tls-ca, --tls-cert and --tls-key go together")
        return None
    for path in (authority, certificate, key):
        if not path.is_file():
            raise typer.BadParameter(f"there is no file '{path}'")
    return Tls(authority, certificate, key)


def _engine(
    workers: int | None, scheduler: str | None, tls: Tls | None
) -> AbstractContextManager[Engine]:
    """What carries the bundles out."""
    from testbed.campaigns.cluster import local_workers, workers_at
    from testbed.campaigns.conduct import InThisProcess

    if scheduler is not None:
        if workers is not None:
            raise typer.BadParameter("--workers is for local ones, --scheduler for a cluster's")
        return workers_at(scheduler, tls)
    if tls is not None:
        raise typer.BadParameter("the TLS options go with --scheduler")
    if workers is None and find_spec("distributed") is None:
        note(["no Dask: one run after the other; pip install '.[cluster]' uses all processors"])
        workers = 0
    return nullcontext(InThisProcess()) if workers == 0 else local_workers(workers)
