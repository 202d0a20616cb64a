"""Files of motions: Fourier coefficients (TOML), and samples for a controller (CSV)."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tomli_w
from pydantic import BaseModel, Field

from testbed.core.base.contents import sha256_of_file
from testbed.core.base.errors import ExperimentError
from testbed.core.base.files import atomic_output
from testbed.core.base.installation import installed_version
from testbed.core.base.toml_text import (
    STRICT_TABLE,
    Finite,
    Positive,
    read_toml,
    validate_tables,
)
from testbed.core.base.whole_files import write_atomically
from testbed.core.robot.tree import Tree
from testbed.motion.fourier import Fourier
from testbed.motion.rest_to_rest import RestToRest, rest_to_rest

if TYPE_CHECKING:
    from testbed.motion.excite import Excitation

MOST_SAMPLES = 5e6
"""Largest number of samples of a trajectory file."""

_HEAD = """\
# A motion, made by testbed {version}, excite.
# q_j(t) = offset + sum over k = 1, 2, ... of sine_k sin(k w t) + cosine_k cos(k w t),
# w = 2 pi fundamental [Hz]; rad or m, joint side. To run it: file = "this file" under [motion].
# What limits leave of it: testbed excite --check.

"""


class _JointTable(BaseModel):
    """Table of a joint's Fourier coefficients."""

    model_config = STRICT_TABLE

    offset: Finite
    sine: Annotated[list[Finite], Field(max_length=1000)]
    cosine: Annotated[list[Finite], Field(max_length=1000)]


class _MotionTables(BaseModel):
    """Tables of a motion file; `limits`, `predicted` and `proof` are accepted but not used."""

    model_config = STRICT_TABLE

    model: str
    model_sha256: str = ""
    fundamental: Positive
    joint: dict[str, _JointTable]
    limits: dict[str, Any] = Field(default_factory=dict)
    predicted: dict[str, Any] = Field(default_factory=dict)
    proof: list[Any] = Field(default_factory=list)


@dataclass(frozen=True, eq=False)
class MotionFile:
    """Content of a motion file.

    Attributes:
        path: Path of the file.
        model: Path of the model file that the motion was designed for.
        motion: Motion, with joints in the order of `names`.
        names: Names of the joints.
    """

    path: Path
    model: Path
    motion: Fourier
    names: tuple[str, ...]

    def motion_for(self, tree: Tree) -> Fourier:
        """Motion with joints in the order of a robot.

        Args:
            tree: The robot.

        Raises:
            ExperimentError: The sets of joint names differ.
        """
        if set(self.names) != set(tree.names):
            hint = ""
            if set(self.names) < set(tree.names):
                hint = (
                    "; hold those which the motion leaves out, "
                    "by --set robot.lock.JOINT=POSITION"
                )
            raise ExperimentError(
                f"{self.path} moves {', '.join(self.names)}; the robot has "
                f"{', '.join(tree.names)}{hint}"
            )
        order = [self.names.index(name) for name in tree.names]
        return Fourier.from_coefficients(
            self.motion.fundamental, self.motion.coefficients[order]
        )


def read_motion(path: Path) -> MotionFile:
    """Read a motion file.

    Args:
        path: File from `write_motion`, or another TOML file with the model, the fundamental
            frequency and one table per joint.

    Raises:
        ExperimentError: The file is invalid.
    """
    tables = validate_tables(_MotionTables, read_toml(path, "motion"), str(path))
    counts = {
        len(coefficients)
        for joint in tables.joint.values()
        for coefficients in (joint.sine, joint.cosine)
    }
    if len(counts) != 1 or 0 in counts:
        raise ExperimentError(
            f"{path}: all joints need sines and cosines, equally many, found {sorted(counts)}"
        )
    if "\0" in tables.model:
        raise ExperimentError(f"{path}: model is not a file name")
    rows = [
        [joint.offset, *joint.sine, *joint.cosine] for joint in tables.joint.values()
    ]
    return MotionFile(
        path=path,
        model=(path.parent / tables.model).resolve(),
        motion=Fourier.from_coefficients(tables.fundamental, np.array(rows)),
        names=tuple(tables.joint),
    )


def write_motion(path: Path, excitation: Excitation, model: Path) -> None:
    """Write the Fourier coefficients of a designed motion to a TOML file for `read_motion`.

    The model file is recorded by its path relative to the written file and by its SHA-256 hash.

    Args:
        path: Path of the file, which is replaced if it exists.
        excitation: The designed motion.
        model: Path of the robot's model file.
    """
    motion = excitation.design.motion
    joints = zip(
        excitation.tree.names, motion.offset, motion.sine, motion.cosine, strict=True
    )
    tables = {
        "model": Path(
            os.path.relpath(model.resolve(), path.resolve().parent)
        ).as_posix(),
        "model_sha256": sha256_of_file(model),
        "fundamental": motion.fundamental,
        "joint": {
            name: {
                "offset": float(offset),
                "sine": sine.tolist(),
                "cosine": cosine.tolist(),
            }
            for name, offset, sine, cosine in joints
        },
    }
    write_atomically(
        path, _HEAD.format(version=installed_version()) + tomli_w.dumps(tables)
    )


def write_trajectory(
    path: Path, excitation: Excitation, rate: float, duration: float
) -> RestToRest:
    """Write samples of a motion from rest to rest: time, positions, velocities, accelerations.

    Columns are time, position/JOINT, velocity/JOINT, acceleration/JOINT [s, rad or m]. The periodic
    part, for identification, begins at time zero; earlier samples lead from rest to the periodic
    part, and samples after its end lead back to rest.

    Args:
        path: Path of the CSV file, which is replaced if it exists.
        excitation: The designed motion.
        rate: Sampling rate [Hz].
        duration: Requested duration of the periodic part, rounded to whole periods [s].

    Returns:
        Motion with its start and end.

    Raises:
        ExperimentError: The file would have more than MOST_SAMPLES samples.
        NoFeasibleMotion: The robot cannot start the motion from rest.
    """
    motion = rest_to_rest(excitation.design.motion, excitation.rules, duration)
    start_duration = motion.start.duration
    count = rate * (motion.end + 2 * start_duration)
    if count > MOST_SAMPLES:
        raise ExperimentError(
            f"{count / rate:g} s at {rate:g} Hz are {count:.1e} samples, more than "
            f"{MOST_SAMPLES:.0e}; choose a lower --rate or a shorter motion.duration"
        )
    first = -int(np.floor(start_duration * rate + 1e-9))
    last = int(np.floor((motion.end + start_duration) * rate + 1e-9))
    samples = motion.at(np.arange(first, last + 1) / rate)
    kinds = ("position", "velocity", "acceleration")
    header = [
        "time",
        *(f"{kind}/{name}" for kind in kinds for name in excitation.tree.names),
    ]
    table = np.column_stack([samples.t, samples.q, samples.qd, samples.qdd])
    with (
        atomic_output(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerow(header)
        np.savetxt(file, table, "%.16g", ",")
    return motion
