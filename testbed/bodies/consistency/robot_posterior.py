"""Posterior of a robot's bodies from estimates and a model file: `plate + prior(robot)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, consistent, robot_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import RobotSamples, robots
from testbed.bodies.prior import prior_of
from testbed.bodies.write_model import FixedLinkShare
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
from testbed.core.parameters.symbols import STANDARD_NAMES
from testbed.core.robot.model_file import model_file_of
from testbed.core.robot.tree import Tree, require_tree


@dataclass(frozen=True, eq=False)
class FilePrior(Value):
    """Prior bodies of a model file, to be added to estimates.

    Attributes:
        robot: Robot with the bodies of its file.
        options: Options of consistent bodies, with the prior error.
    """

    robot: Tree
    options: ConsistencyOptions

    def __add__(self, data: Estimate | Information) -> RobotPosterior:
        """Posterior of physically consistent bodies from data and model file.

        Raises:
            SettingsError: `data` is not an estimate of `identify`, or contains other data.
        """
        return self.__radd__(data)

    def __radd__(self, data: Estimate | Information) -> RobotPosterior:
        addends = data.estimates if isinstance(data, Information) else (data,)
        estimates = tuple(each for each in addends if isinstance(each, Estimate))
        if not estimates or len(estimates) < len(addends):
            raise SettingsError(
                "a model file's bodies are added to estimates of `identify`"
            )
        return RobotPosterior(self, estimates)


def prior(robot: Tree, error: float = 0.3) -> FilePrior:
    """Prior bodies of a robot's model file, to be added to estimates.

    Args:
        robot: Robot with the bodies of its file.
        error: Relative standard deviation of every body's mass, centre of mass and inertia.
    """
    require_tree(robot, "prior(robot, error)")
    return FilePrior(robot, ConsistencyOptions(prior_error=error))


@dataclass(frozen=True, eq=False, repr=False)
class RobotPosterior(Summarized):
    """Posterior of a robot's physically consistent bodies from data and model file.

    Attributes:
        prior: Prior bodies of the model file.
        estimates: Estimates of the data.
    """

    prior: FilePrior
    estimates: tuple[Estimate, ...]

    @cached_property
    def bodies(self) -> Consistent:
        """Physically consistent bodies from data and model file, with standard deviations."""
        prior = self.prior
        return consistent(
            prior.robot, self.estimates, prior_of(prior.robot), prior.options
        )

    @cached_property
    def robot(self) -> Tree:
        """Robot with the physically consistent bodies, friction and rotor inertias."""
        return robot_of(self.bodies, self.prior.robot)

    def sample(self, count: int, seed: int = 0) -> RobotSamples:
        """Sample robots from the posterior.

        Args:
            count: Number of samples.
            seed: Seed of the random numbers.
        """
        prior, rng = self.prior, np.random.default_rng(seed)
        bodies = prior_of(prior.robot)
        return robots(prior.robot, self.estimates, bodies, count, rng, prior.options)

    @property
    def summary(self) -> SummaryTable:
        """Table of the mass and first moments of every link, with standard deviations."""
        bodies = self.bodies
        sources = " + ".join(each.instrument for each in self.estimates)
        rows = [
            (
                "link",
                *(
                    f"{name} [{'kg' if name == 'm' else 'kg m'}]"
                    for name in STANDARD_NAMES[:4]
                ),
            )
        ]
        for k, link in enumerate(bodies.links):
            numbers = zip(
                bodies.standard[k].tolist(), bodies.sigma[k].tolist(), strict=True
            )
            rows.append((link, *(number_with_sigma(*pair) for pair in [*numbers][:4])))
        title = f"{len(bodies.links)} bodies by {sources} + model file"
        return SummaryTable(title, tuple(rows))


def write_model(
    robot: RobotPosterior | Tree,
    path: str | Path,
    *,
    fixed: FixedLinkShare = "lump",
    note: Sequence[str] = (),
) -> tuple[Diagnostic, ...]:
    """Write a copy of a model file with a robot's masses, friction and rotor inertias.

    Args:
        robot: Robot, or posterior of estimates and model file (`plate + prior(robot)`).
        path: Path of the copy, in the format of the robot's file (URDF or MJCF).
        fixed: Part of a body's inertia that is written to links fixed to other links: none
            ("lump"), or a part in proportion to their inertia in the file ("share").
        note: Lines of a comment at the beginning of the copy's root element.

    Returns:
        Diagnostics of values that the format cannot express or that readers change.

    Raises:
        ModelError: The file cannot be edited or must not be overwritten, or `path` has the wrong
            extension for its format.
    """
    tree = robot if isinstance(robot, Tree) else robot.robot
    return write_tree(model_file_of(tree), tree, Path(path), fixed=fixed, note=note)
