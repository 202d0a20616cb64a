"""Estimates rebuilt from summaries, and checks of their parameters against a problem."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from testbed.core.base.errors import (
    SettingsError,
    count_with_noun,
    shortened_list,
    vector_text,
)
from testbed.core.dynamics.drive_set import make_drive_set
from testbed.core.estimation.estimate import (
    Estimate,
    EstimateSummary,
    channel_names,
    channel_units,
)
from testbed.core.estimation.problem import Problem, method_minimal_set
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.robot.tree import Tree


def estimate_of_summary(tree: Tree, summary: EstimateSummary) -> Estimate:
    """Estimate rebuilt from a summary, with minimal set and joint terms but without data.

    Values, covariance and residuals are those of the summary. Normal equations and numbers of rows
    are zero; condition number and relative residuals are nan.

    Args:
        tree: Robot; its gravity is replaced by that of the summary.
        summary: Summary of the estimate; its settings contain known zeros and joint terms.

    Raises:
        SettingsError: The summary's parameters differ from those of the robot.
    """
    tree, parameter_count = tree.with_gravity(summary.gravity), len(summary.names)
    minimal = method_minimal_set(tree, summary.method, summary.settings)
    drives = (
        make_drive_set(tree, minimal, summary.settings.words)
        if summary.method == "torque"
        else None
    )
    parameters = minimal if drives is None else drives
    if parameters.names != summary.names:
        raise SettingsError(
            f"the {summary.method} estimate is of other parameters than this robot's"
        )
    channels = channel_names(tree, summary.method)
    channel_count = len(channels)
    no_equations = NormalEquations(
        summary.names,
        channels,
        np.zeros(channel_count),
        np.zeros((channel_count, parameter_count, parameter_count)),
        np.zeros((channel_count, parameter_count)),
        np.zeros(channel_count),
    )
    values = {
        each.name: getattr(summary, each.name) for each in fields(EstimateSummary)
    }
    return Estimate(
        **values,
        channels=channels,
        channel_units=channel_units(tree, summary.method),
        relative_residual=np.full(channel_count, np.nan),
        samples=(0,) * channel_count,
        condition=np.nan,
        normal_equations=no_equations,
        diagnostics=(),
        minimal=minimal,
        drives=drives,
        joints=tree.names,
    )


def check_parameters(problem: Problem, summary: EstimateSummary) -> None:
    """Check that an estimate has the parameters and channels of a problem.

    Args:
        problem: Problem of another recording of the robot.
        summary: Summary of the estimate.

    Raises:
        SettingsError: The gravity of the recording leads to a different minimal set, or the names
            or order of the parameters or the number of channels differ.
    """
    tree, minimal, names = problem.tree, problem.minimal, problem.names
    estimate_set = method_minimal_set(
        tree.with_gravity(summary.gravity), summary.method, problem.settings
    )
    if not (
        minimal.count == estimate_set.count
        and np.allclose(minimal.matrix, estimate_set.matrix)
    ):
        raise SettingsError(
            f"the estimate was made under gravity {vector_text(summary.gravity)}, "
            "the recording has "
            f"{vector_text(tree.gravity)} m/s^2: other combinations of parameters count there"
        )
    if names != summary.names:
        extra = [name for name in summary.names if name not in names]
        missing = [name for name in names if name not in summary.names]
        phrases = [f"{shortened_list(extra)} are not among them"] if extra else []
        phrases += [f"it lacks {shortened_list(missing)}"] if missing else []
        raise SettingsError(
            f"the {summary.method} estimate is not of this robot's parameters "
            "under these settings: "
            f"{', and '.join(phrases) or 'they are in another order'}"
        )
    if len(summary.residual) != len(problem.channels):
        raise SettingsError(
            f"the {summary.method} estimate has residuals of "
            f"{count_with_noun(len(summary.residual), 'channel')}, the "
            f"robot has {len(problem.channels)}"
        )
