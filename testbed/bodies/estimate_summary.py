"""What an estimate says, without the data that it was made from; and the rows that it is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.errors import SettingsError, components, few, plural
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.estimation.estimate import Estimate, Method, channel_units, channels_of
from testbed.core.estimation.problem import Problem, set_of
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    standard_deviations,
)
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.sensors.corrected import corrected


@dataclass(frozen=True, eq=False)
class EstimateSummary:
    """What an estimate says, without the data that it was made from.

    Attributes:
        method: "external" or "internal".
        names: Of the parameters, (p,).
        values: (p,).
        covariance: (p, p).
        gravity: That was assumed, (3,) [m/s^2], bedplate frame.
        residual: Rms of the estimate's own residuals, (channels,) [N, N m].
        nuisances: Numbers of the instrument that were estimated, by name, such as "pose/rx".
        unidentifiable: Names of parameters that are not, the plate's zero being unknown.
        settings: How its recording became equations.
    """

    method: Method
    names: tuple[str, ...]
    values: Array
    covariance: Array
    gravity: Array
    residual: Array
    nuisances: Mapping[str, float]
    unidentifiable: tuple[str, ...] = ()
    settings: Settings = DEFAULTS

    def __post_init__(self) -> None:
        p = len(self.names)
        freeze(self, values=(p,), covariance=(p, p), gravity=(3,), residual=(None,))


def summary_of(estimate: Estimate) -> EstimateSummary:
    """What an estimate says.

    Args:
        estimate: With its data.
    """
    return EstimateSummary(
        method=estimate.method,
        names=estimate.names,
        values=estimate.values,
        covariance=estimate.covariance,
        gravity=estimate.gravity,
        residual=estimate.residual,
        nuisances={each.name: each.value for each in estimate.nuisances},
        unidentifiable=estimate.unidentifiable,
        settings=estimate.settings,
    )


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
    drives = drive_set(tree, minimal, said.settings.words) if said.method == "internal" else None
    known = minimal if drives is None else drives
    if known.names != said.names:
        raise SettingsError(f"the {said.method} estimate is of other parameters than this robot's")
    channels = channels_of(tree, said.method)
    c = len(channels)
    none = NormalEquations(
        said.names, channels, np.zeros(c), np.zeros((c, p, p)), np.zeros((c, p)), np.zeros(c)
    )
    sigma = standard_deviations(said.covariance)
    return Estimate(
        method=said.method,
        names=said.names,
        units=known.units,
        values=said.values,
        sigma=sigma,
        covariance=said.covariance,
        gravity=said.gravity,
        channels=channels,
        channel_units=channel_units(tree, said.method),
        residual=said.residual,
        relative_residual=np.full(c, np.nan),
        samples=(0,) * c,
        condition=np.nan,
        normal_equations=none,
        diagnostics=(),
        minimal=minimal,
        drives=drives,
        joints=tree.names,
        settings=said.settings,
    ).without(said.unidentifiable)


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


def corrected_by(source: Source, tree: Tree, said: EstimateSummary) -> Source:
    """A recording, faults of the instrument that an estimate has found taken back.

    Those that are of one recording only, the plate's zero and drift, stay.

    Args:
        source: The recording, of the same instrument.
        tree: The robot.
        said: The estimate.

    Raises:
        UnknownName: The estimate has a number that no instrument has.
    """
    return corrected(source, tree, said.nuisances)
