"""How estimates grow with the data: from the first seconds of a run, and from more and more.

For the eye: the noise of parts is taken for white where the whole shows nothing else that matters.
That takes a fifth of the time and moves values by a part of their sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.arrays import Array
from testbed.errors import RecordingError, UnseenParameters
from testbed.experiment.run import Run
from testbed.experiment.score import relative_errors
from testbed.identification.estimate import Estimate, Method
from testbed.identification.identify import identify
from testbed.identification.settings import Settings

STAGES, FEW = 12, 6
"""Estimates from more and more of a recording; and of a robot of many joints."""

MANY = 12
"""Joints of such a robot."""

SHORTEST = 1 / 30
"""The first is from this part of the recording."""


EVEN = 0.5
"""Weight of constants of the channels from which on the whole's answer is with them."""

LONG = 20_000
"""Samples of a recording that itself was worth loading the compiled kernel for."""


@dataclass(frozen=True, eq=False)
class Growth:
    """Estimates from the first seconds of a recording, and from more and more of it.

    Attributes:
        time: Until when, (k,) [s]; the last is the whole recording.
        values: (k, p); not a number where the data did not suffice.
    """

    time: Array
    values: Array


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
        settings = settings_of_parts(whole, run.settings, recording.samples)
        values = np.full((len(parts) + 1, len(whole.names)), np.nan)
        values[-1] = whole.values
        for k, samples in enumerate(parts):
            part = recording.part(0, samples)
            try:
                values[k] = identify(run.tree, part, method, settings=settings).values
            except (RecordingError, UnseenParameters):
                continue
        time = np.array([*(recording.time[samples - 1] for samples in parts), end])
        found[method] = Growth(time, values)
    return found


def settings_of_parts(whole: Estimate, settings: Settings, samples: int) -> Settings:
    """How parts of a recording are treated, for the eye.

    Args:
        whole: The estimate from all of it.
        settings: Those of that.
        samples: Of all of it.
    """
    if settings.engine == "by size" and samples > LONG:
        settings = replace(settings, engine="compiled")
    constants = whole.noise is not None and whole.noise.bias_weight > EVEN
    if constants or settings.nuisances or settings.known or settings.tare == "unknown":
        return settings  # what only the long way finds
    return replace(settings, noise="white")


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
