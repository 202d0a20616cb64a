"""A motion as a file: TOML that says what it is, for which robot, and what is proven."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from testbed.errors import ExperimentError
from testbed.excitation.fourier import Fourier
from testbed.experiment.experiment_tables import Table
from testbed.robot.tree import Tree
from testbed.toml_text import Finite, Positive, checked, read_toml


class _Joint(Table):
    offset: Finite
    sine: Annotated[list[Finite], Field(max_length=1000)]
    cosine: Annotated[list[Finite], Field(max_length=1000)]


class _Limit(Table):
    position: tuple[Finite, Finite]
    velocity: Positive
    acceleration: Positive
    effort: Positive | None = None


class _Proven(Table):
    limit: str
    left: Finite
    unit: str
    instant: Finite


class _File(Table):
    model: str
    model_sha256: str = ""
    fundamental: Positive
    joint: dict[str, _Joint]
    limits: dict[str, _Limit] = Field(default_factory=dict)
    predicted: dict[str, Finite] = Field(default_factory=dict)
    proof: list[_Proven] = Field(default_factory=list)


@dataclass(frozen=True, eq=False)
class MotionFile:
    """What a motion file says.

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
                    "; hold those which the motion leaves out, by --set robot.lock.JOINT=POSITION"
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
    counts = {len(part) for joint in found.joint.values() for part in (joint.sine, joint.cosine)}
    if len(counts) != 1 or 0 in counts:
        raise ExperimentError(
            f"{path}: all joints need sines and cosines, equally many, found {sorted(counts)}"
        )
    if "\0" in found.model:
        raise ExperimentError(f"{path}: model is not a file name")
    rows = [[joint.offset, *joint.sine, *joint.cosine] for joint in found.joint.values()]
    return MotionFile(
        path=path,
        model=(path.parent / found.model).resolve(),
        motion=Fourier.of(found.fundamental, np.array(rows)),
        names=tuple(found.joint),
    )
