"""Carry out a campaign: its runs that have no result yet, on several processes."""

from __future__ import annotations

import hashlib
import multiprocessing
import signal
import time
import warnings
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import testbed
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.results import RESULTS, read_results, write_rows
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.contents import fingerprint
from testbed.core.base.errors import ExperimentError, TestbedError, printable
from testbed.core.base.installation import versions
from testbed.core.base.stages import Progress, unreported
from testbed.core.robot.model_file import references
from testbed.lab.experiment.experiment import Experiment

SAVE_EVERY = 10.0
"""Seconds between two writings of the table."""

ASIDE: Any = {"model": True, "name": True, "claim": True, "motion": {"file"}}
"""Keys of an experiment that do not determine its result; files do by their content."""


@dataclass(frozen=True)
class CampaignRun:
    """One run of a campaign.

    Attributes:
        run: Hash of all that determines its result.
        cell: Number of its cell.
        replicate: Number of its replicate.
    """

    run: str
    cell: int
    replicate: int


def places_of(campaign: Campaign) -> list[CampaignRun]:
    """List the runs of a campaign, replicate by replicate and in each cell by cell.

    Args:
        campaign: The campaign.

    Raises:
        TestbedError: The experiment of a run cannot be read.
    """
    digest, code = cache(_model_digest), code_version()
    places = []
    for replicate, cell in product(
        range(campaign.tables.replicates), range(len(campaign.cells))
    ):
        experiment = campaign.experiment(cell, replicate)
        parts = [experiment.model_dump_json(exclude=ASIDE)]
        parts += [*campaign.tables.methods, code, digest(experiment.model)]
        if experiment.motion.file:
            parts.append(fingerprint(Path(experiment.motion.file)))
        run = hashlib.sha256("\n".join(parts).encode()).hexdigest()
        places.append(CampaignRun(run, cell, replicate))
    return places


def _model_digest(path: str) -> str:
    """Digest of a model file and of all files that it refers to."""
    files = sorted({Path(path).resolve(), *references(Path(path))})
    return " ".join(fingerprint(file) for file in files)


@cache
def code_version() -> str:
    """Digest of the package's modules, and of the versions of the packages that it uses."""
    home = Path(testbed.__file__).parent
    digest = hashlib.sha256(repr(sorted(versions().items())).encode())
    for path in sorted(home.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def conduct(
    campaign: Campaign,
    folder: Path,
    workers: int = 0,
    limit: int | None = None,
    progress: Progress = unreported,
) -> None:
    """Carry out the runs of a campaign that have no result yet.

    Args:
        campaign: What to do.
        folder: Folder of the table, which is written again every few seconds.
        workers: Number of processes; 0 for this one.
        limit: Largest number of runs; default all.
        progress: Called with the number of rows and of runs.

    Raises:
        TestbedError: The table is another campaign's, cannot be read, or a process has died.
    """
    path, places = folder / RESULTS, places_of(campaign)
    rows = _finished(path, places)
    missing = [place for place in places if place.run not in rows][:limit]
    start = time.monotonic()
    try:
        with closing(_carried_out(campaign, missing, workers)) as results:
            for row in results:
                rows[row["run"]] = row
                progress(len(rows), len(places))
                if time.monotonic() - start > SAVE_EVERY:
                    _write(path, campaign, places, rows)
                    start = time.monotonic()
    except BrokenProcessPool:
        raise ExperimentError(
            "a process has died, perhaps for lack of memory; what had come is kept: the same "
            "command with fewer --workers goes on with the rest"
        ) from None
    finally:
        _write(path, campaign, places, rows)


def _finished(path: Path, places: Sequence[CampaignRun]) -> dict[str, dict[str, Any]]:
    """Rows with a result, by run.

    Raises:
        ExperimentError: The folder is no campaign's, or of other runs.
    """
    if not path.exists():
        if path.parent.exists() and any(path.parent.iterdir()):
            raise ExperimentError(
                f"'{path.parent}' is no campaign's folder; name another with --out"
            )
        return {}
    rows = {
        row["run"]: row for row in read_results(path).rows if row["status"] == "done"
    }
    if rows.keys() - {place.run for place in places}:
        raise ExperimentError(
            f"'{path}' has runs of another campaign, or of another version of testbed, Python or "
            "its packages; name another folder with --out"
        )
    return rows


def _write(
    path: Path,
    campaign: Campaign,
    places: Sequence[CampaignRun],
    rows: Mapping[str, Mapping[str, Any]],
) -> None:
    """Write the rows that there are, each with its place in the campaign."""
    table = []
    for place in places:
        if place.run in rows:
            levels = campaign.cells[place.cell].levels
            named = {
                f"factor/{k}": v for k, v in zip(campaign.factors, levels, strict=True)
            }
            numbers = {"cell": place.cell, "replicate": place.replicate}
            table.append({**rows[place.run], **numbers, **named})
    write_rows(path, campaign, table)


def _carried_out(
    campaign: Campaign, places: Sequence[CampaignRun], workers: int
) -> Generator[dict[str, Any]]:
    """Rows of runs, in order."""
    run = partial(carry_out_run, campaign)
    if not workers:
        yield from map(run, places)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _leave_interrupts)
    try:
        yield from pool.map(run, places)
    finally:
        pool.shutdown(cancel_futures=True)


def _leave_interrupts() -> None:
    """Leave Ctrl-C to the command."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def carry_out_run(campaign: Campaign, place: CampaignRun) -> dict[str, Any]:
    """Row of a run; a failure is a row like any other.

    Args:
        campaign: Whose run it is.
        place: Which.
    """
    seed = campaign.tables.seed + place.replicate
    row: dict[str, Any] = {"run": place.run, "seed": seed, "status": "done"}
    row |= {"error": "", "command": campaign.command(place.cell, place.replicate)}
    try:
        with warnings.catch_warnings(), one_blas_thread():
            # numerical doubt is a diagnostic of the result
            warnings.simplefilter("ignore")
            experiment = campaign.experiment(place.cell, place.replicate)
            return row | _results(experiment, campaign)
    except Exception as error:
        name = "" if isinstance(error, TestbedError) else f"{type(error).__name__}: "
        return row | {"status": "failed", "error": printable(name + str(error))}


def _results(experiment: Experiment, campaign: Campaign) -> dict[str, Any]:
    """Metrics, estimates and diagnostics of an experiment, by column."""
    from testbed.lab.experiment.evaluate import evaluate
    from testbed.lab.experiment.record import record

    run = evaluate(
        experiment, record(experiment), methods=campaign.tables.methods, threads=1
    )
    if run.score is None or not run.estimates:
        raise ExperimentError("; ".join(run.failures.values()))
    estimates = []
    for method, estimate in run.estimates.items():
        errors = run.score.errors[method]
        columns = (
            estimate.names,
            errors.truth,
            estimate.values,
            estimate.sigma,
            errors.relative,
        )
        for name, *numbers in zip(*columns, strict=True):
            truth, value, sigma, relative = map(float, numbers)
            estimates.append(
                {
                    "method": method,
                    "parameter": name,
                    "truth": truth,
                    "value": value,
                    "sigma": sigma,
                    "relative_error": relative,
                }
            )
    metrics = {f"metric/{name}": value for name, value in run.score.metrics.items()}
    diagnostics = [each.code for each in run.diagnostics]
    return metrics | {"estimates": estimates, "diagnostics": diagnostics}
