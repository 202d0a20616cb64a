"""Motion files: Fourier coefficients, and samples for a controller."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tomli_w
from pydantic import BaseModel, Field

from testbed.core.base.contents import fingerprint
from testbed.core.base.errors import ExperimentError
from testbed.core.base.files import replacing
from testbed.core.base.installation import version
from testbed.core.base.toml_text import KNOWN_KEYS, Finite, Positive, checked, read_toml
from testbed.core.base.whole_files import write_whole
from testbed.core.robot.tree import Tree
from testbed.motion.fourier import Fourier
from testbed.motion.rest_to_rest import RestToRest, rest_to_rest

if TYPE_CHECKING:
    from testbed.motion.excite import Excitation

MOST_SAMPLES = 5e6
"""Of a file."""

_HEAD = """\
# A motion, made by testbed {version}, excite.
# q_j(t) = offset + sum over k = 1, 2, ... of sine_k sin(k w t) + cosine_k cos(k w t),
# w = 2 pi fundamental [Hz]; rad or m, joint side. To run it: file = "this file" under [motion].
# What limits leave of it: testbed excite --check.

"""


class _Joint(BaseModel):
    model_config = KNOWN_KEYS

    offset: Finite
    sine: Annotated[list[Finite], Field(max_length=1000)]
    cosine: Annotated[list[Finite], Field(max_length=1000)]


class _File(BaseModel):
    model_config = KNOWN_KEYS

    model: str
    model_sha256: str = ""
    fundamental: Positive
    joint: dict[str, _Joint]
    limits: dict[str, Any] = Field(default_factory=dict)
    predicted: dict[str, Any] = Field(default_factory=dict)
    proof: list[Any] = Field(default_factory=list)


@dataclass(frozen=True, eq=False)
class MotionFile:
    """Content of a motion file.

    Attributes:
        path: The file.
        model: The model file it was made for.
        motion: Columns in the order of `names`.
        names: Of the joints.
    """

    path: Path
    model: Path
    motion: Fourier
    names: tuple[str, ...]

    def motion_for(self, tree: Tree) -> Fourier:
        """The motion in the order of a robot's joints.

        Args:
            tree: The robot.

        Raises:
            ExperimentError: It has other joints.
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
        return Fourier.of(self.motion.fundamental, self.motion.coefficients[order])


def read_motion(path: Path) -> MotionFile:
    """Read a motion.

    Args:
        path: A file that `write_motion` wrote, or one of the same form: model, fundamental and
            a table for each joint do.

    Raises:
        ExperimentError: It is no such file.
    """
    found = checked(_File, read_toml(path, "motion"), str(path))
    counts = {
        len(part)
        for joint in found.joint.values()
        for part in (joint.sine, joint.cosine)
    }
    if len(counts) != 1 or 0 in counts:
        raise ExperimentError(
            f"{path}: all joints need sines and cosines, equally many, found {sorted(counts)}"
        )
    if "\0" in found.model:
        raise ExperimentError(f"{path}: model is not a file name")
    rows = [
        [joint.offset, *joint.sine, *joint.cosine] for joint in found.joint.values()
    ]
    return MotionFile(
        path=path,
        model=(path.parent / found.model).resolve(),
        motion=Fourier.of(found.fundamental, np.array(rows)),
        names=tuple(found.joint),
    )


def write_motion(path: Path, found: Excitation, model: Path) -> None:
    """Write a motion.

    Args:
        path: The file; what stands there is replaced.
        found: The motion.
        model: The robot's model file.
    """
    motion = found.design.motion
    joints = zip(
        found.tree.names, motion.offset, motion.sine, motion.cosine, strict=True
    )
    tables = {
        "model": Path(
            os.path.relpath(model.resolve(), path.resolve().parent)
        ).as_posix(),
        "model_sha256": fingerprint(model),
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
    write_whole(path, _HEAD.format(version=version()) + tomli_w.dumps(tables))


def write_trajectory(
    path: Path, found: Excitation, rate: float, duration: float
) -> RestToRest:
    """Write a motion's samples: columns time, position/JOINT, velocity/JOINT, acceleration/JOINT.

    Time is zero where the periodic motion begins: what is recorded from there on, whole periods,
    is for the estimate; what comes before leads from rest into it, what comes after to rest.

    Args:
        path: The CSV file; what stands there is replaced.
        found: The motion.
        rate: Samples a second [Hz].
        duration: Wished for the periodic part [s].

    Returns:
        The motion with its start and end.

    Raises:
        ExperimentError: Too many samples.
        InfeasibleMotion: The motion cannot begin from rest.
    """
    motion = rest_to_rest(found.design.motion, found.rules, duration)
    lead = motion.start.duration
    count = rate * (motion.end + 2 * lead)
    if count > MOST_SAMPLES:
        raise ExperimentError(
            f"{count / rate:g} s at {rate:g} Hz are {count:.1e} samples, more than "
            f"{MOST_SAMPLES:.0e}; choose a lower --rate or a shorter motion.duration"
        )
    first = -int(np.floor(lead * rate + 1e-9))
    last = int(np.floor((motion.end + lead) * rate + 1e-9))
    samples = motion.at(np.arange(first, last + 1) / rate)
    kinds = ("position", "velocity", "acceleration")
    head = ["time", *(f"{kind}/{name}" for kind in kinds for name in found.tree.names)]
    table = np.column_stack([samples.t, samples.q, samples.qd, samples.qdd])
    with (
        replacing(path) as fresh,
        fresh.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerow(head)
        np.savetxt(file, table, "%.16g", ",")
    return motion
