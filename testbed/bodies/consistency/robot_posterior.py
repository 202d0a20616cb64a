"""Bodies of a robot by measurements and its model file: `plate + prior(robot)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, consistent, robot_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import Robots, robots
from testbed.bodies.prior import prior_of
from testbed.bodies.write_model import Fixed
from testbed.bodies.write_model import write_model as write_tree
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import SettingsError
from testbed.core.base.summary_table import (
    Summarized,
    SummaryTable,
    Value,
    number_with_sigma,
)
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.information import Information
from testbed.core.parameters.symbols import STANDARD
from testbed.core.robot.model_file import file_of
from testbed.core.robot.tree import Tree, require_tree


@dataclass(frozen=True, eq=False)
class FilePrior(Value):
    """Bodies of a model file before any data, to be added to estimates.

    Attributes:
        robot: The robot with the bodies of its file.
        options: What is asked of bodies, the prior error among it.
    """

    robot: Tree
    options: ConsistencyOptions

    def __add__(self, data: Estimate | Information) -> RobotPosterior:
        """Physically consistent bodies by data and file together."""
        return self.__radd__(data)

    def __radd__(self, data: Estimate | Information) -> RobotPosterior:
        found = data.estimates if isinstance(data, Information) else (data,)
        estimates = tuple(each for each in found if isinstance(each, Estimate))
        if not estimates or len(estimates) < len(found):
            raise SettingsError(
                "a model file's bodies are added to estimates of `identify`"
            )
        return RobotPosterior(self, estimates)


def prior(robot: Tree, error: float = 0.3) -> FilePrior:
    """The bodies of a robot's model file, to be added to estimates.

    Args:
        robot: The robot with the bodies of its file.
        error: Standard deviation of every body's mass, centre and inertia, in parts of themselves.
    """
    require_tree(robot, "prior(robot, error)")
    return FilePrior(robot, ConsistencyOptions(prior_error=error))


@dataclass(frozen=True, eq=False, repr=False)
class RobotPosterior(Summarized):
    """A robot's bodies by data and model file: physically consistent.

    Attributes:
        prior: The model file's bodies.
        estimates: Of the data.
    """

    prior: FilePrior
    estimates: tuple[Estimate, ...]

    @cached_property
    def bodies(self) -> Consistent:
        """Likeliest bodies, with covariances and what the data had to give way."""
        prior = self.prior
        return consistent(
            prior.robot, self.estimates, prior_of(prior.robot), prior.options
        )

    @cached_property
    def robot(self) -> Tree:
        """The robot with these bodies, friction and rotor inertias."""
        return robot_of(self.bodies, self.prior.robot)

    def sample(self, count: int, seed: int = 0) -> Robots:
        """Draw robots that could be the one that was measured.

        Args:
            count: How many.
            seed: Of the random numbers.
        """
        prior, rng = self.prior, np.random.default_rng(seed)
        believed = prior_of(prior.robot)
        return robots(prior.robot, self.estimates, believed, count, rng, prior.options)

    @property
    def summary(self) -> SummaryTable:
        """Mass and centre of mass of every link, a row each."""
        found = self.bodies
        sources = " + ".join(each.instrument for each in self.estimates)
        rows = [
            (
                "link",
                *(
                    f"{name} [{'kg' if name == 'm' else 'kg m'}]"
                    for name in STANDARD[:4]
                ),
            )
        ]
        for k, link in enumerate(found.links):
            numbers = zip(
                found.standard[k].tolist(), found.sigma[k].tolist(), strict=True
            )
            rows.append((link, *(number_with_sigma(*pair) for pair in [*numbers][:4])))
        head = f"{len(found.links)} bodies by {sources} + model file"
        return SummaryTable(head, tuple(rows))


def write_model(
    robot: RobotPosterior | Tree,
    path: str | Path,
    *,
    fixed: Fixed = "lump",
    note: Sequence[str] = (),
) -> tuple[Diagnostic, ...]:
    """Write a copy of a model file with a robot's masses, friction and rotors.

    Args:
        robot: A robot, or estimates and model file together (`plate + prior(robot)`).
        path: URDF or MJCF, as the file that the robot was read from.
        fixed: What of a body goes to links fixed to others: nothing ("lump"), or in proportion to
            what they had ("share").
        note: Lines of a comment.

    Returns:
        What the format has no place for.

    Raises:
        ModelError: The file cannot be edited, or is not to be overwritten.
    """
    tree = robot if isinstance(robot, Tree) else robot.robot
    return write_tree(file_of(tree), tree, Path(path), fixed=fixed, note=note)
