"""The command about many runs: campaign."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import Json, Set, app

if TYPE_CHECKING:
    from testbed.campaign.conduct import Engine


@app.command()
def campaign(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.toml", help="Campaign file; with --summary its folder.")
    ],
    settings: Set = None,
    out: Annotated[
        Path | None, typer.Option(help="Campaign's folder; default runs/NAME-campaign.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List and count the runs, estimate time and disk.")
    ] = False,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first runs.")] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=0, help="Local processes; default one a processor, 0: in this one."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Carry out many runs of an experiment: factors, replicates, one table.

    The same command again does what is missing. A run that fails is a row of the table, with what
    makes it again; exit code 1 if there is one.

    Example: testbed campaign experiments/campaigns/coverage.toml --limit 20
    """
    from testbed.campaign.campaign import Campaign
    from testbed.campaign.conduct import conduct
    from testbed.report import terminal
    from testbed.report.campaign_lines import Throughput, print_conducted, print_plan

    asked = Campaign.load(file, settings or ())
    folder = out or Path("runs") / f"{asked.tables.name}-campaign"
    if dry_run:
        print_plan(terminal.console(), asked, folder, limit)
        return
    with Throughput() as throughput:
        found = conduct(asked, folder, _engine(workers), limit, throughput)
    failures = print_conducted(terminal.console(), found)
    raise typer.Exit(1 if failures else 0)


def _engine(workers: int | None) -> Engine:
    from testbed.campaign.conduct import InThisProcess

    return InThisProcess()
