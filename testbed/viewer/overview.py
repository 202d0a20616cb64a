"""What a run's first picture shows: a few parameters as the data grow, beside the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from testbed.arrays import Array
from testbed.experiment.score import relative_errors
from testbed.identification.estimate import METHODS, Method
from testbed.identification.influence import by_influence
from testbed.viewer.colours import COLOURS
from testbed.viewer.curves import series
from testbed.viewer.scene import Scene, rounded_up

MOST = 6
"""Parameters shown: as many as a plate has channels."""

SETTLED = 1 / 3
"""The scale is that of the errors after this part of the recording."""


@dataclass(frozen=True, eq=False)
class Learned:
    """One parameter, as more and more of the recording is used.

    Attributes:
        name: Of it.
        time: Until when, (k,) [s].
        errors: By method: distance from the true value, or where that is not known from the first
            method's last one, as `Errors.relative` takes it, (k,) [%]; not a number where the data
            did not suffice.
    """

    name: str
    time: Array
    errors: Mapping[Method, Array]


def scale_of(shown: Sequence[Learned]) -> float:
    """Error at which all plots end, so that one may be compared with the other [%].

    Args:
        shown: At least one.
    """
    widest = 0.0
    for each in shown:
        late = each.time >= each.time[0] + SETTLED * (each.time[-1] - each.time[0])
        off = np.concatenate([np.abs(errors[late]) for errors in each.errors.values()])
        widest = max(widest, float(np.nanmax(off, initial=0.0)))
    return rounded_up(widest)


def learned(scene: Scene) -> tuple[Learned, ...]:
    """The parameters to show first: those that add most to what is predicted.

    Args:
        scene: The run, with its growth; without it there are none.
    """
    grown, estimates = scene.growth, scene.run.estimates
    methods = [method for method in METHODS if method in grown]
    if not methods:
        return ()
    bases = {method: estimates[method].base for method in methods}
    shared = [n for n in bases[methods[-1]].names if all(n in b.names for b in bases.values())]
    names = shared or list(bases[methods[0]].names)
    order = by_influence([estimates[method] for method in methods], scene.run.truths)
    names = sorted(names, key=order.index)[:MOST]
    methods = [method for method in methods if set(names) <= set(bases[method].names)]
    first = bases[methods[0]]
    places = {method: [bases[method].names.index(name) for name in names] for method in methods}
    last = {method: bases[method].values[places[method]] for method in methods}
    units = [first.units[k] for k in places[methods[0]]]
    truths = scene.run.truths
    aims = [truths.get(n, value) for n, value in zip(names, last[methods[0]], strict=True)]
    errors = {
        m: 100 * relative_errors(grown[m].values[:, places[m]], np.array(aims), units)
        for m in methods
    }
    return tuple(
        Learned(
            name=name,
            time=grown[methods[0]].time,
            errors={m: errors[m][:, k] for m in methods},
        )
        for k, name in enumerate(names)
    )


def log_overview(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """A plot a parameter: zero, and how far off each method has been so far."""
    zero = "truth" if scene.run.truths else "last value"
    for k, each in enumerate(learned(scene)):
        values = np.column_stack(list(each.errors.values()))
        there = np.isfinite(values).any(axis=1)
        if not there.any():
            continue
        path, time = f"{at}/{k}", each.time[there]
        line = np.zeros((int(there.sum()), 1))
        series(stream, f"{path}/aim", time, line, [zero], [COLOURS["measured"]], [3.0])
        labels = list(each.errors)
        colours = [COLOURS[label] for label in labels]
        series(stream, path, time, values[there], labels, colours, [2.0] * len(labels))
