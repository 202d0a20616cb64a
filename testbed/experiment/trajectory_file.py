"""A designed motion as samples for a real controller: from rest, whole periods, to rest."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.errors import ExperimentError
from testbed.excitation.rest_to_rest import RestToRest, rest_to_rest
from testbed.experiment.excite import Excitation
from testbed.experiment.versions import versions
from testbed.files import replacing
from testbed.recordings.columns import UNITS
from testbed.recordings.formats.parquet import write_table
from testbed.robot.tree import Tree

MOST_SAMPLES = 5e6
"""Of a file."""

_SIGNALS = {"position": "q", "velocity": "qd", "acceleration": "qdd"}


def write_trajectory(path: Path, found: Excitation, rate: float) -> RestToRest:
    """Write a motion's samples: columns time, position/JOINT, velocity/JOINT, acceleration/JOINT.

    Time is zero where the periodic motion begins: what is recorded from there on, whole periods,
    is for the estimate; what comes before leads from rest into it, what comes after to rest.

    Args:
        path: The file, .csv or .parquet; what stands there is replaced.
        found: The motion.
        rate: Samples a second [Hz].

    Returns:
        The motion with its start and end.

    Raises:
        ExperimentError: Neither of the two formats, or too many samples.
        InfeasibleMotion: The motion cannot begin from rest.
    """
    check_ending(path)
    tree, duration = found.tree, found.experiment.motion.duration
    motion = rest_to_rest(found.design.motion, found.rules, duration)
    length = motion.end + 2 * motion.start.duration
    if rate * length > MOST_SAMPLES:
        raise ExperimentError(
            f"{length:g} s at {rate:g} Hz are {rate * length:.1e} samples, more than "
            f"{MOST_SAMPLES:.0e}; choose a lower --rate or a shorter motion.duration"
        )
    samples = samples_of(motion, rate)
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
    return motion


def check_ending(path: Path) -> None:
    """Whether samples can be written to a file.

    Args:
        path: The file.

    Raises:
        ExperimentError: Its ending is of neither format.
    """
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ExperimentError(f"'{path}': samples are written as .csv or .parquet")


def samples_of(motion: RestToRest, rate: float) -> Motion:
    """Samples from rest to rest; time is zero where the periodic motion begins.

    Args:
        motion: From rest to rest.
        rate: Samples a second [Hz].
    """
    lead = motion.start.duration
    first = -int(np.floor(lead * rate + 1e-9))
    last = int(np.floor((motion.end + lead) * rate + 1e-9))
    return motion.at(np.arange(first, last + 1) / rate)


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
