"""A designed motion as files: for this program with its proof, and for a controller."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.errors import ExperimentError
from testbed.excitation.limits import Limits
from testbed.excitation.rest_to_rest import RestToRest, rest_to_rest
from testbed.experiment.excite import Excitation
from testbed.experiment.versions import versions
from testbed.files import fingerprint, replacing
from testbed.recordings.columns import UNITS
from testbed.recordings.formats.parquet import write_table
from testbed.robot.tree import Tree

_HEAD = """\
# A motion, made by testbed {version}, excite.
# q_j(t) = offset + sum over k = 1, 2, ... of sine_k sin(k w t) + cosine_k cos(k w t),
# w = 2 pi fundamental; rad or m, joint side. To run it: file = "this file" under [motion].
"""


def write_motion(path: Path, found: Excitation) -> None:
    """Write a motion.

    Args:
        path: The file; what stands there is replaced.
        found: The motion, its proof, and what it promises.
    """
    design, predicted, tree = found.design, found.predicted, found.tree
    model, limits = Path(found.experiment.model), found.rules.limits
    motion = design.motion
    named = os.path.relpath(model.resolve(), path.resolve().parent)
    lines = [
        _HEAD.format(version=versions()["testbed"]),
        f"model = {json.dumps(Path(named).as_posix())}",
        f"model_sha256 = {json.dumps(fingerprint(model))}",
        f"fundamental = {motion.fundamental!r}  # Hz",
    ]
    for j, name in enumerate(tree.names):
        lines += ["", f"[joint.{json.dumps(name)}]", f"offset = {float(motion.offset[j])!r}"]
        lines += [f"sine = {_list(motion.sine[j])}", f"cosine = {_list(motion.cosine[j])}"]
    lines += ["", "[limits]  # rad or m, and per s, per s^2; N m or N"]
    lines += [f"{json.dumps(name)} = {_limit(limits, j)}" for j, name in enumerate(tree.names)]
    lines += ["", "[predicted]  # standard deviation of each parameter as a share of its value"]
    pairs = zip(predicted.names, predicted.relative, strict=True)
    lines += [f"{json.dumps(name)} = {float(share):.4g}" for name, share in pairs]
    for margin in design.proof.margins:
        lines += ["", "[[proof]]  # what is left of what may be used, at every moment"]
        lines += [f"limit = {json.dumps(margin.label)}", f"left = {margin.left:.6g}"]
        lines += [f'unit = "{margin.unit or "share"}"', f"instant = {margin.instant:.6g}  # s"]
    with replacing(path) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _list(values: Array) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _limit(limits: Limits, joint: int) -> str:
    low, high = float(limits.low[joint]), float(limits.high[joint])
    parts = [f"position = [{low!r}, {high!r}]", f"velocity = {float(limits.velocity[joint])!r}"]
    parts.append(f"acceleration = {float(limits.acceleration[joint])!r}")
    if np.isfinite(limits.effort[joint]):
        parts.append(f"effort = {float(limits.effort[joint])!r}")
    return "{ " + ", ".join(parts) + " }"


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
