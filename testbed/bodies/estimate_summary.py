"""Estimates without their data: their structure again, and problems of the same parameters."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from testbed.core.base.errors import SettingsError, components, few, plural
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.estimation.estimate import (
    Estimate,
    EstimateSummary,
    channel_units,
    channels_of,
)
from testbed.core.estimation.problem import Problem, set_of
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.robot.tree import Tree


def estimate_of_summary(tree: Tree, said: EstimateSummary) -> Estimate:
    """An estimate with its structure again, but without the sums that it was made from.

    Args:
        tree: The robot.
        said: The estimate; its settings say zeros and terms.

    Raises:
        SettingsError: It is of other parameters.
    """
    tree, p = tree.with_gravity(said.gravity), len(said.names)
    minimal = set_of(tree, said.method, said.settings)
    drives = (
        drive_set(tree, minimal, said.settings.words)
        if said.method == "internal"
        else None
    )
    known = minimal if drives is None else drives
    if known.names != said.names:
        raise SettingsError(
            f"the {said.method} estimate is of other parameters than this robot's"
        )
    channels = channels_of(tree, said.method)
    c = len(channels)
    none = NormalEquations(
        said.names,
        channels,
        np.zeros(c),
        np.zeros((c, p, p)),
        np.zeros((c, p)),
        np.zeros(c),
    )
    stated = {each.name: getattr(said, each.name) for each in fields(EstimateSummary)}
    return Estimate(
        **stated,
        channels=channels,
        channel_units=channel_units(tree, said.method),
        relative_residual=np.full(c, np.nan),
        samples=(0,) * c,
        condition=np.nan,
        normal_equations=none,
        diagnostics=(),
        minimal=minimal,
        drives=drives,
        joints=tree.names,
    )


def check_parameters(problem: Problem, said: EstimateSummary) -> None:
    """Whether an estimate is of a problem's parameters.

    Args:
        problem: Another recording of the robot.
        said: The estimate.

    Raises:
        SettingsError: It is of other parameters, or was made under another gravity.
    """
    tree, minimal, names = problem.tree, problem.minimal, problem.names
    then = set_of(tree.with_gravity(said.gravity), said.method, problem.settings)
    if not (minimal.count == then.count and np.allclose(minimal.matrix, then.matrix)):
        raise SettingsError(
            f"the estimate was made under gravity {components(said.gravity)}, the recording has "
            f"{components(tree.gravity)} m/s^2: other combinations of parameters count there"
        )
    if names != said.names:
        extra = [name for name in said.names if name not in names]
        lacking = [name for name in names if name not in said.names]
        phrases = [f"{few(extra)} are not among them"] if extra else []
        phrases += [f"it lacks {few(lacking)}"] if lacking else []
        raise SettingsError(
            f"the {said.method} estimate is not of this robot's parameters under these settings: "
            f"{', and '.join(phrases) or 'they are in another order'}"
        )
    if len(said.residual) != len(problem.channels):
        raise SettingsError(
            f"the {said.method} estimate has residuals of "
            f"{plural(len(said.residual), 'channel')}, the "
            f"robot has {len(problem.channels)}"
        )
