"""What a run's first picture shows: a few parameters as the data grow, beside the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr

from testbed.arrays import Array
from testbed.identification.estimate import METHODS, Method
from testbed.viewer.colours import COLOURS
from testbed.viewer.curves import series
from testbed.viewer.robot_drawing import clock
from testbed.viewer.scene import Scene

MOST = 6
"""Parameters shown: as many as a plate has channels."""

SETTLED = 1 / 3
"""The scale is that of the values after this part of the recording."""

ROOM = 1.3
"""Of the scale, beyond what is farthest from the middle."""


@dataclass(frozen=True, eq=False)
class Learned:
    """One parameter, as more and more of the recording is used.

    Attributes:
        name: Of it.
        unit: Its unit.
        truth: Its true value; None where that is not known.
        time: Until when, (k,) [s].
        values: By method, (k,); not a number where the data did not suffice.
    """

    name: str
    unit: str
    truth: float | None
    time: Array
    values: Mapping[Method, Array]

    @property
    def scale(self) -> tuple[float, float]:
        """Values between which the plot opens: the truth, or the last value, is in the middle."""
        late = self.time >= self.time[0] + SETTLED * (self.time[-1] - self.time[0])
        last = [values[-1] for values in self.values.values()]
        middle = float(last[0]) if self.truth is None else self.truth
        off = np.concatenate([values[late] - middle for values in self.values.values()])
        widest = float(np.nanmax(np.abs(off), initial=0.0))
        half = ROOM * max(widest, 1e-6 * abs(middle), 1e-12)
        return middle - half, middle + half


def learned(scene: Scene) -> tuple[Learned, ...]:
    """The parameters to show first: those on which the methods differ most, in their own order.

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
    methods = [method for method in methods if set(names) <= set(bases[method].names)]
    first = bases[methods[0]]
    places = {method: [bases[method].names.index(name) for name in names] for method in methods}
    last = {method: bases[method].values[places[method]] for method in methods}
    differ = np.abs(last[methods[-1]] - last[methods[0]])
    doubt = first.sigma[places[methods[0]]]
    rank = np.argsort(-differ / np.maximum(doubt, np.finfo(float).tiny), kind="stable")
    return tuple(
        Learned(
            name=names[k],
            unit=first.units[places[methods[0]][k]],
            truth=scene.run.truths.get(names[k]),
            time=grown[methods[0]].time,
            values={m: grown[m].values[:, places[m][k]] for m in methods},
        )
        for k in sorted(rank[:MOST].tolist())
    )


def log_overview(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """A plot a parameter: its truth, and what each method has learned of it so far."""
    for k, each in enumerate(learned(scene)):
        labels = list(each.values)
        columns = list(each.values.values())
        there = np.isfinite(np.column_stack(columns)).any(axis=1)
        if not there.any():
            continue
        path, index = f"{at}/{k}", clock(each.time[there])
        if each.truth is not None:
            truth = np.full((int(there.sum()), 1), each.truth)
            series(stream, f"{path}/truth", index, truth, ["truth"], [COLOURS["measured"]], [3.0])
        values = np.column_stack(columns)[there]
        colours = [COLOURS[label] for label in labels]
        series(stream, path, index, values, labels, colours, [2.0] * len(labels))
