"""A designed motion as samples for a real controller: from rest, whole periods, to rest."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.errors import ExperimentError
from testbed.excitation.rest_to_rest import Start, start_of
from testbed.experiment.excite import Excitation
from testbed.experiment.versions import versions
from testbed.files import replacing
from testbed.recordings.columns import UNITS
from testbed.recordings.formats.parquet import write_table
from testbed.robot.tree import Tree

MOST_SAMPLES = 5e6
"""Of a file."""

_SIGNALS = {"position": "q", "velocity": "qd", "acceleration": "qdd"}


def write_trajectory(path: Path, found: Excitation, rate: float) -> Start:
    """Write a motion's samples: columns time, position/JOINT, velocity/JOINT, acceleration/JOINT.

    Time is zero where the periodic motion begins: what is recorded from there on, whole periods,
    is for the estimate; what comes before leads from rest into it, what comes after to rest.

    Args:
        path: The file, .csv or .parquet; what stands there is replaced.
        found: The motion.
        rate: Samples a second [Hz].

    Returns:
        How the motion begins.

    Raises:
        ExperimentError: Neither of the two formats, or too many samples.
        InfeasibleMotion: The motion cannot begin from rest.
    """
    check_ending(path)
    motion, tree = found.design.motion, found.tree
    start, _ = start_of(motion, found.rules)
    periods = max(1, round(found.experiment.motion.duration / motion.period))
    length = periods * motion.period + 2 * start.duration
    if rate * length > MOST_SAMPLES:
        raise ExperimentError(
            f"{length:g} s at {rate:g} Hz are {rate * length:.1e} samples, more than "
            f"{MOST_SAMPLES:.0e}; choose a lower --rate or a shorter motion.duration"
        )
    samples = rest_to_rest(start, periods, rate)
    units = {"time": "s"} | {
        f"{signal}/{joint.name}": UNITS[joint.kind][signal]
        for signal in _SIGNALS
        for joint in tree.joints
    }
    columns = _columns(samples, tree)
    with replacing(path) as fresh:
        if path.suffix.lower() == ".csv":
            _write_csv(fresh, columns)
        else:
            facts = {"robot": tree.name, "period": motion.period, "versions": versions()}
            write_table(fresh, units, facts, [columns])
    return start


def check_ending(path: Path) -> None:
    """Whether samples can be written to a file.

    Args:
        path: The file.

    Raises:
        ExperimentError: Its ending is of neither format.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ExperimentError(f"'{path}': samples are written as .csv or .parquet")


def rest_to_rest(start: Start, periods: int, rate: float) -> Motion:
    """Samples from rest to rest; time is zero where the periodic motion begins.

    Args:
        start: The way into the motion; the way out is its mirror image.
        periods: Of the motion between.
        rate: Samples a second [Hz].
    """
    lead, end = start.duration, periods * start.motion.period
    first = -int(np.floor(lead * rate + 1e-9))
    last = int(np.floor((end + lead) * rate + 1e-9))
    time = np.arange(first, last + 1) / rate
    before, after = time < 0, time > end
    parts = [start.motion.derivative(time, order) for order in range(3)]
    back = start.backwards
    for order, part in enumerate(parts):
        part[before] = start.derivative(time[before] + lead, order)
        part[after] = (-1) ** order * back.derivative(end + lead - time[after], order)
    return Motion(time, *parts)


def _columns(samples: Motion, tree: Tree) -> dict[str, Array]:
    found = {"time": samples.t}
    for signal, attribute in _SIGNALS.items():
        values: Array = getattr(samples, attribute)
        found |= {f"{signal}/{name}": values[:, j] for j, name in enumerate(tree.names)}
    return found


def _write_csv(path: Path, columns: dict[str, Array]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in np.column_stack(list(columns.values())):
            writer.writerow([repr(value) for value in row.tolist()])
