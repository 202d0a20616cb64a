"""Execution of a campaign: runs without a result, on several processes."""

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

import numpy as np

import testbed
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.results import (
    PARAMETER_NUMBERS,
    RESULTS_FILE,
    read_campaign_results,
    write_rows,
)
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.contents import sha256_of_file
from testbed.core.base.errors import ExperimentError, TestbedError, printable_line
from testbed.core.base.installation import package_versions
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.robot.model_file import referenced_files
from testbed.lab.experiment.experiment import Experiment

SAVE_EVERY = 10.0
"""Time between two writings of the table [s]."""

EXCLUDED_KEYS: Any = {"model": True, "name": True, "claim": True, "motion": {"file"}}
"""Keys of an experiment that do not affect the result; files count by their content."""


@dataclass(frozen=True)
class CampaignRun:
    """Run of a campaign, identified by a hash of its inputs.

    Attributes:
        digest: Hash of all inputs that determine the result: experiment, methods, contents of model
            and motion files, versions of code and packages.
        cell: Index of the cell.
        replicate: Index of the replicate.
    """

    digest: str
    cell: int
    replicate: int


def campaign_runs(campaign: Campaign) -> list[CampaignRun]:
    """Runs of a campaign, ordered by replicate, then by cell.

    Args:
        campaign: The campaign.

    Raises:
        TestbedError: The experiment of a run cannot be read.
    """
    digest, code = cache(_model_digest), code_version()
    runs = []
    for replicate, cell in product(
        range(campaign.tables.replicates), range(len(campaign.cells))
    ):
        experiment = campaign.experiment(cell, replicate)
        parts = [experiment.model_dump_json(exclude=EXCLUDED_KEYS)]
        parts += [*campaign.tables.methods, code, digest(experiment.model)]
        if experiment.motion.file:
            parts.append(sha256_of_file(Path(experiment.motion.file)))
        run = hashlib.sha256("\n".join(parts).encode()).hexdigest()
        runs.append(CampaignRun(run, cell, replicate))
    return runs


def _model_digest(path: str) -> str:
    """Text with the hashes of a model file and of the files it refers to.

    The hashes are in the order of the paths.
    """
    files = sorted({Path(path).resolve(), *referenced_files(Path(path))})
    return " ".join(sha256_of_file(file) for file in files)


@cache
def code_version() -> str:
    """Hash of testbed's modules and of the versions of its dependencies."""
    package_folder = Path(testbed.__file__).parent
    digest = hashlib.sha256(repr(sorted(package_versions().items())).encode())
    for path in sorted(package_folder.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def conduct(
    campaign: Campaign,
    folder: Path,
    workers: int = 0,
    limit: int | None = None,
    progress: Progress = ignore_progress,
) -> None:
    """Carry out the runs of a campaign that have no result, and write the table.

    Runs that failed in an earlier call are repeated. Rows of finished runs are written even if the
    call ends with an exception.

    Args:
        campaign: The campaign.
        folder: Folder of the table `RESULTS_FILE`, which is rewritten every `SAVE_EVERY` seconds.
        workers: Number of processes; 0 to use this process only.
        limit: Largest number of runs to carry out; default all.
        progress: Called with the number of rows and the number of all runs.

    Raises:
        TestbedError: The table belongs to another campaign or cannot be read, or a process has
            died. Errors of single runs are not raised but recorded in their rows (`carry_out_run`).
    """
    path, runs = folder / RESULTS_FILE, campaign_runs(campaign)
    rows = _finished_rows(path, runs)
    missing_runs = [run for run in runs if run.digest not in rows][:limit]
    start = time.monotonic()
    try:
        with closing(_result_rows(campaign, missing_runs, workers)) as results:
            for row in results:
                rows[row["run"]] = row
                progress(len(rows), len(runs))
                if time.monotonic() - start > SAVE_EVERY:
                    _write_table(path, campaign, runs, rows)
                    start = time.monotonic()
    except BrokenProcessPool:
        raise ExperimentError(
            "a process has died, perhaps for lack of memory; what had come is kept: the same "
            "command with fewer --workers goes on with the rest"
        ) from None
    finally:
        _write_table(path, campaign, runs, rows)


def _finished_rows(
    path: Path, runs: Sequence[CampaignRun]
) -> dict[str, dict[str, Any]]:
    """Rows of the table with status "done", keyed by the run's digest.

    The result is empty if there is no table.

    Args:
        path: File of the table.
        runs: Runs of the campaign.

    Raises:
        ExperimentError: The folder contains other files but no table, or the table contains other
            runs.
    """
    if not path.exists():
        if path.parent.exists() and any(path.parent.iterdir()):
            raise ExperimentError(
                f"'{path.parent}' is no campaign's folder; name another with --out"
            )
        return {}
    rows = {
        row["run"]: row
        for row in read_campaign_results(path).rows
        if row["status"] == "done"
    }
    if rows.keys() - {run.digest for run in runs}:
        raise ExperimentError(
            f"'{path}' has runs of another campaign, or of another version of testbed, Python or "
            "its packages; name another folder with --out"
        )
    return rows


def _write_table(
    path: Path,
    campaign: Campaign,
    runs: Sequence[CampaignRun],
    rows: Mapping[str, Mapping[str, Any]],
) -> None:
    """Write the available rows in the order of the runs.

    Columns for digest, cell, replicate and levels are added.

    Args:
        path: File of the table.
        campaign: The campaign.
        runs: Runs of the campaign.
        rows: Rows with a result, keyed by the run's digest.
    """
    table = []
    for run in runs:
        if run.digest in rows:
            levels = campaign.cells[run.cell].levels
            level_columns = {
                f"factor/{k}": v for k, v in zip(campaign.factors, levels, strict=True)
            }
            table.append({**rows[run.digest], **vars(run), **level_columns})
    write_rows(path, campaign, table)


def _result_rows(
    campaign: Campaign, runs: Sequence[CampaignRun], workers: int
) -> Generator[dict[str, Any]]:
    """Carry out runs on worker processes, and yield their rows in the order of `runs`.

    Args:
        campaign: The campaign.
        runs: Runs to carry out.
        workers: Number of processes; 0 to use this process only.
    """
    run_in_campaign = partial(carry_out_run, campaign)
    if not workers:
        yield from map(run_in_campaign, runs)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _ignore_interrupts)
    try:
        yield from pool.map(run_in_campaign, runs)
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C in a worker process; the main process handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def carry_out_run(campaign: Campaign, run: CampaignRun) -> dict[str, Any]:
    """Carry out a run, and return its table row with results or error message.

    If an exception occurs, it is not raised; the status is "failed" instead of "done".

    Args:
        campaign: The campaign.
        run: Run of the campaign.
    """
    seed = campaign.tables.seed + run.replicate
    row: dict[str, Any] = {"run": run.digest, "seed": seed, "status": "done"}
    row |= {"error": "", "command": campaign.command(run.cell, run.replicate)}
    try:
        with warnings.catch_warnings(), one_blas_thread():
            # numerical problems are diagnostics of the result
            warnings.simplefilter("ignore")
            experiment = campaign.experiment(run.cell, run.replicate)
            return row | _result_columns(experiment, campaign)
    except Exception as error:
        name = "" if isinstance(error, TestbedError) else f"{type(error).__name__}: "
        return row | {"status": "failed", "error": printable_line(name + str(error))}


def _result_columns(experiment: Experiment, campaign: Campaign) -> dict[str, Any]:
    """Metrics, estimates and diagnostic codes of a simulated experiment, by column.

    The columns are "metric/NAME", "estimates" (for each parameter a dictionary of method, name,
    truth, value, sigma and relative error), and "diagnostics".

    Args:
        experiment: Experiment of the run.
        campaign: The campaign, which defines the methods of identification.

    Raises:
        ExperimentError: No method gave an estimate.
    """
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
        columns = errors.truth, estimate.values, estimate.sigma, errors.relative
        for name, numbers in zip(estimate.names, np.transpose(columns), strict=True):
            row = dict(zip(PARAMETER_NUMBERS, numbers.tolist(), strict=True))
            estimates.append({"method": method, "parameter": name} | row)
    metrics = {f"metric/{name}": value for name, value in run.score.metrics.items()}
    diagnostics = [each.code for each in run.diagnostics]
    return metrics | {"estimates": estimates, "diagnostics": diagnostics}
