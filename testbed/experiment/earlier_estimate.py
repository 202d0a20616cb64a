"""What an earlier estimate knows already of the parameters that a motion is to tell."""

from __future__ import annotations

import numpy as np

from testbed.arrays import Array
from testbed.errors import ExperimentError
from testbed.experiment.evaluate import robot_of
from testbed.experiment.experiment import Experiment
from testbed.experiment.read_result import KeptResult
from testbed.parameters.minimal_set import minimal_set
from testbed.parameters.rules import Model


def prior_covariance(kept: KeptResult, experiment: Experiment) -> Array:
    """The covariance of an earlier estimate in the order of an experiment's parameters, (N, N).

    Args:
        kept: The estimates of a file.
        experiment: Says which parameters are wanted.

    Raises:
        ExperimentError: The file's estimates are of other parameters.
    """
    joints = experiment.excitation.instrument == "joints"
    wanted = "internal" if joints else "external"
    model: Model = "dynamic" if joints else "reaction"
    zeros = experiment.identification.zeros
    names = minimal_set(robot_of(experiment), model, zeros=zeros).names
    for estimate in kept.estimates:
        if estimate.method == wanted and set(names) <= set(estimate.names):
            order = [estimate.names.index(name) for name in names]
            return np.array(estimate.covariance)[np.ix_(order, order)]
    raise ExperimentError(
        f"the earlier result has no {wanted} estimate of {', '.join(names)}: it must be of the "
        "same robot, with the same identification.zeros"
    )
