"""The command about many runs: campaign."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import Set, app, note
from testbed.installation import own_or_shipped

if TYPE_CHECKING:
    from testbed.campaign.cluster import Tls
    from testbed.campaign.conduct import Engine


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
    rrd: Annotated[
        Path | None, typer.Option(help="With --summary: also write this .rrd file.")
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
        _summary(file, against, rrd)
        return
    from testbed.campaign.campaign import Campaign
    from testbed.campaign.conduct import conduct
    from testbed.campaign.results import CAMPAIGN, LOCK
    from testbed.files import check_writable
    from testbed.reporting import output
    from testbed.reporting.campaign import Throughput, print_conducted, print_plan

    asked = Campaign.load(file, settings or ())
    folder = out or Path("runs") / f"{asked.tables.name}-campaign"
    if dry_run:
        print_plan(output.console(), asked, folder, limit)
        return
    if not (folder / LOCK).exists():  # the folder's own file may ask for what is missing
        check_writable(folder / CAMPAIGN, read=(file, asked.base))
    tls = _tls(tls_ca, tls_cert, tls_key)
    with _engine(workers, scheduler, tls) as engine, Throughput() as throughput:
        found = conduct(asked, folder, engine, limit, throughput.of)
    failures = print_conducted(output.console(), found)
    raise typer.Exit(1 if failures else 0)


def _summary(folder: Path, against: Path | None, rrd: Path | None) -> None:
    """Print what a campaign says, and write it beside its table."""
    from testbed.campaign.summary import changes, read_campaign, summarise, write_summary
    from testbed.files import check_writable
    from testbed.reporting import output
    from testbed.reporting.campaign import print_changes, print_summary, write_campaign_page

    check_writable(rrd, read=(folder, against))
    with output.Progress("summarising"):
        found = summarise(read_campaign(folder))
    out, place = output.console(), folder if folder.is_dir() else folder.parent
    if against is not None:
        with output.Progress("summarising"):
            lines = list(changes(summarise(read_campaign(against)), found))
        print_changes(out, lines)
        return
    page = place / "summary.html"
    with output.Progress("drawing"):
        write_campaign_page(page, found)
        if rrd is not None:
            from testbed.viewer.campaign_log import write_campaign_rrd

            write_campaign_rrd(found, rrd)
    print_summary(out, found, [page, *write_summary(found, place)])


def _tls(authority: Path | None, certificate: Path | None, key: Path | None) -> Tls | None:
    """Files of an encrypted connection, all or none.

    Raises:
        BadParameter: One is missing, or is no file.
    """
    from testbed.campaign.cluster import Tls

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
    from testbed.campaign.cluster import local_workers, workers_at
    from testbed.campaign.conduct import InThisProcess

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
