"""Work for campaigns that measure the engine and not the robot: outcomes that hashes decide."""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

from testbed.campaigns.bundle import Bundle, Outcome
from testbed.campaigns.campaign import Campaign
from testbed.campaigns.cluster import Work, local_workers, workers_at
from testbed.campaigns.conduct import conduct
from testbed.core.base.errors import TestbedError

BUSY = 0.02
"""Seconds of processor time that a run takes."""


def trivial(bundle: Bundle) -> tuple[list[Outcome], float]:
    """No work at all."""
    start = time.perf_counter()
    found = [_outcome(run) for run, _ in bundle.runs]
    return found, time.perf_counter() - start


def busy(bundle: Bundle, seconds: float = BUSY) -> tuple[list[Outcome], float]:
    """So much processor time a run.

    Args:
        bundle: The runs.
        seconds: Of each.
    """
    start = time.perf_counter()
    found = []
    for run, _ in bundle.runs:
        end = time.process_time() + seconds
        while time.process_time() < end:
            sum(range(500))
        found.append(_outcome(run))
    return found, time.perf_counter() - start


WORKS: dict[str, Work] = {"trivial": trivial, "busy": busy, "busier": partial(busy, seconds=0.2)}


def _outcome(run: str) -> Outcome:
    value = float(np.random.default_rng(int(run, 16)).normal())
    return Outcome(run, "done", metrics={"external_max_z": value})


def main(file: str, folder: str, work: str, workers: str) -> int:
    """Carry out a campaign by other work, as the command would; its exit code.

    Args:
        file: Of the campaign.
        folder: Its folder.
        work: One of WORKS.
        workers: How many, or the address of a scheduler.
    """
    campaign = Campaign.load(file)
    local = workers.isdigit()
    chosen = WORKS[work]
    engines = local_workers(int(workers), chosen) if local else workers_at(workers, work=chosen)
    try:
        with engines as engine:
            found = conduct(campaign, Path(folder), engine)
    except TestbedError as error:
        print(error, file=sys.stderr)
        return 2
    return int(bool(found.failures()))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
