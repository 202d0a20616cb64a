"""How estimates grow with the data: from the first seconds of a run, and from more and more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError, UnseenParameters
from testbed.experiment.run import Run
from testbed.experiment.score import relative_errors
from testbed.identification.estimate import Method
from testbed.identification.identify import identify

STAGES, FEW = 12, 6
"""Estimates from more and more of a recording; and of a robot of many joints."""

MANY = 12
"""Joints of such a robot."""

SHORTEST = 1 / 30
"""The first is from this part of the recording."""


@dataclass(frozen=True, eq=False)
class Growth:
    """Estimates from the first seconds of a recording, and from more and more of it.

    Attributes:
        time: Until when, (k,) [s]; the last is the whole recording.
        values: (k, p); not a number where the data did not suffice.
        sigma: (k, p).
    """

    time: Array
    values: Array
    sigma: Array


def growth(run: Run, times: Sequence[float] | None = None) -> dict[Method, Growth]:
    """A run's estimates from more and more of its recording, by method.

    Args:
        run: The run.
        times: From the beginning until when [s]; default a dozen, or half of it for a robot of
            many joints, each longer by one factor.
    """
    recording = run.recording
    start, end = float(recording.time[0]), float(recording.time[-1])
    if times is None:
        stages = FEW if run.tree.n > MANY else STAGES
        times = np.geomspace(SHORTEST * (end - start), end - start, stages)[:-1].tolist()
    last = np.searchsorted(recording.time, start + np.asarray(times), "right").tolist()
    parts = [samples for samples in last if samples < recording.samples]
    found = {}
    for method, whole in run.estimates.items():
        values, sigma = np.full((2, len(parts) + 1, len(whole.names)), np.nan)
        values[-1], sigma[-1] = whole.values, whole.sigma
        for k, samples in enumerate(parts):
            try:
                part = identify(
                    run.tree,
                    recording.part(0, samples),
                    method,
                    settings=run.settings,
                )
            except (RecordingError, UnseenParameters):
                continue
            values[k], sigma[k] = part.values, part.sigma
        time = np.array([*(recording.time[samples - 1] for samples in parts), end])
        found[method] = Growth(time, values, sigma)
    return found


def growing_errors(run: Run, method: Method, grown: Growth) -> Array:
    """Relative errors of the minimal parameters as the data grow, (k, count).

    Against the truth, or where that is not known against the estimate from all data; scaled
    as in `Errors.relative`.

    Args:
        run: The run.
        method: One that has an estimate.
        grown: How that estimate grew.
    """
    whole = run.estimates[method]
    base, known = whole.base, run.truths
    aim = [known.get(name, value) for name, value in zip(base.names, base.values, strict=True)]
    return relative_errors(grown.values[:, : len(aim)], np.array(aim), base.units)
