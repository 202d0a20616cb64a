"""Carry out a campaign: what is not there yet, bundle by bundle, in whatever way."""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np

from testbed.campaigns.bundle import Bundle, Outcome, carry_out_bundle, code_version, run_hash
from testbed.campaigns.campaign import Campaign, Place
from testbed.campaigns.results import CampaignFolder, own_folder
from testbed.core.base.errors import ExperimentError
from testbed.lab.experiment.experiment import Experiment

WHOLE = 5.0
"""Seconds that a bundle is meant to take; where little is left, bundles are smaller."""

LEAST = 0.5
"""Seconds below which none is made smaller: that would be lost in passing it on."""

MOST = 200
"""Runs of a bundle."""


FIXED = 0.3
"""Seconds of reading the robot, choosing a motion, building the plant."""

PER_SAMPLE, PER_STEP, PER_CANDIDATE = 30e-6, 12e-6, 0.004
"""Seconds of a sample, an integration step (three joints), a random motion that is drawn."""

ROW_BYTES = 1500
"""Of a run in the table."""

SAMPLE_BYTES = 250
"""Of a sample in a recording of three joints that is kept."""


@dataclass(frozen=True)
class Standing:
    """How far a campaign is.

    Attributes:
        done: Runs that are there, results and failures.
        total: Runs that are wanted, as far as is known.
        failed: Failures among those that are there.
        rate: Runs that came a second since the command began.
    """

    done: int
    total: int
    failed: int
    rate: float


@dataclass(frozen=True)
class Supply:
    """Runs that are missing, handed out in bundles.

    Attributes:
        campaign: Of the runs.
        runs: Their hashes, cells and replicates, in order.
        seconds: What one is expected to take, learnt on the way.
    """

    campaign: Campaign
    runs: list[tuple[str, int, int]]
    seconds: list[float] = field(default_factory=list)

    def take(self, workers: int) -> Bundle | None:
        """The next bundle; None when nothing is left.

        Args:
            workers: How many there are.
        """
        if not self.runs:
            return None
        each = max(float(np.median(self.seconds[-20:])), 1e-6)
        share = math.ceil(len(self.runs) / (2 * max(workers, 1)))
        size = min(math.ceil(WHOLE / each), max(share, math.ceil(LEAST / each)), MOST)
        size = max(size, 1)  # a run may be expected to take forever: it fails in no time
        taken, self.runs[:size] = self.runs[:size], []
        campaign = self.campaign
        return Bundle(
            base=str(campaign.base),
            content=campaign.content,
            methods=campaign.tables.methods,
            keeps=campaign.tables.recordings == "keep",
            code=code_version(),
            runs=tuple((run, campaign.words(cell, k)) for run, cell, k in taken),
        )


Answers = Iterator[tuple[list[Outcome], float]]
"""Outcomes of bundles and the seconds that each took, in any order."""


class Engine(Protocol):
    """What carries bundles out."""

    def answers(self, supply: Supply) -> Answers:
        """Outcomes of all that a supply hands out."""
        ...


class InThisProcess:
    """Bundles one after the other, no other process."""

    def answers(self, supply: Supply) -> Answers:
        """Outcomes of all that a supply hands out."""
        while (bundle := supply.take(1)) is not None:
            yield carry_out_bundle(bundle)


def places_of(campaign: Campaign) -> dict[str, Place]:
    """Every run of a campaign by its hash, in the order of replicates and cells.

    Raises:
        TestbedError: The experiment of a run cannot be read.
    """
    found: dict[str, Place] = {}
    for replicate, cell in product(range(campaign.tables.replicates), range(len(campaign.cells))):
        run = run_hash(campaign.experiment(cell, replicate), campaign.tables.methods)
        found.setdefault(run, Place(cell, replicate))  # two cells may say the same
    return found


def conduct(
    campaign: Campaign,
    path: Path,
    engine: Engine,
    limit: int | None = None,
    progress: Callable[[Standing], None] = lambda standing: None,
) -> CampaignFolder:
    """Carry out what is missing of a campaign.

    Args:
        campaign: What to do.
        path: Its folder; what is there already is not done again.
        engine: Carries bundles out.
        limit: Only so many runs, the first ones; default all.
        progress: Called whenever outcomes have come.

    Returns:
        The folder, everything in its table.

    Raises:
        TestbedError: The campaign cannot be carried out as written, or its folder not be written.
    """
    with own_folder(path, campaign.tables):
        folder = CampaignFolder(path, campaign, places_of(campaign))
        try:
            try:
                for runs in _rounds(campaign, folder, limit):
                    _make(campaign, runs, folder, engine, progress)
            finally:
                folder.compact()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise
            raise ExperimentError(
                f"'{path}': {error.strerror}; what was written is kept and whole: make room, and "
                "the same command goes on"
            ) from None
    return folder


def _rounds(campaign: Campaign, folder: CampaignFolder, limit: int | None) -> Iterator[list[str]]:
    """The runs of each round; which ones they are depends on results alone, not on the route."""
    open_cells = set(range(len(campaign.cells)))
    for replicates in campaign.rounds():
        runs = [
            run
            for run, place in folder.places.items()
            if place.replicate in replicates and place.cell in open_cells
        ][:limit]
        yield runs
        if limit is not None:
            limit -= len(runs)
        if campaign.tables.stop is not None:
            open_cells = _unsure(campaign.tables.stop.standard_error, folder, open_cells)


def _unsure(enough: float, folder: CampaignFolder, cells: Collection[int]) -> set[int]:
    """Cells whose mean has a standard error above what is enough."""
    values: dict[int, list[float]] = {cell: [] for cell in cells}
    for run, place in folder.places.items():
        value = folder.figures.get(run)
        if place.cell in values and value is not None:
            values[place.cell].append(value)
    return {
        cell
        for cell, found in values.items()
        if len(found) < 2 or np.std(found, ddof=1) / math.sqrt(len(found)) > enough
    }


def _make(
    campaign: Campaign,
    runs: Sequence[str],
    folder: CampaignFolder,
    engine: Engine,
    progress: Callable[[Standing], None],
) -> None:
    """Carry out those runs that are missing."""
    missing = folder.missing(runs)
    if not missing:
        return
    places, start, came = folder.places, time.monotonic(), 0
    first = places[missing[0]]
    guess = seconds_of(campaign.experiment(first.cell, first.replicate))
    order = [(run, places[run].cell, places[run].replicate) for run in missing]
    for outcomes, seconds in engine.answers(supply := Supply(campaign, order, [guess])):
        folder.add(outcomes)
        supply.seconds.append(seconds / len(outcomes))
        came += len(outcomes)
        failed = sum(status != "done" for status in folder.status.values())
        rate = came / max(time.monotonic() - start, 1e-9)
        progress(Standing(len(runs) - len(missing) + came, len(runs), failed, rate))


def seconds_of(experiment: Experiment) -> float:
    """CPU time of a run [s], simulation and identification."""
    motion, measurement = experiment.motion, experiment.measurement
    time = motion.duration + experiment.simulation.warm_up
    steps = time / experiment.simulation.step
    candidates = 0 if motion.file else motion.candidates
    work = PER_SAMPLE * time * measurement.rate + PER_STEP * steps
    return FIXED + work + PER_CANDIDATE * candidates


def bytes_of(experiment: Experiment, *, keeps: bool) -> float:
    """Place on disk that a run takes.

    Args:
        experiment: Of the run.
        keeps: Whether its recording is kept.
    """
    samples = experiment.motion.duration * experiment.measurement.rate
    return ROW_BYTES + (SAMPLE_BYTES * samples if keeps else 0.0)
