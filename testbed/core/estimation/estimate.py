"""Estimate of the minimal parameters by one method: values, covariance, residuals, diagnostics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.codec import TableSchema
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, sentences
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.summary_table import SummaryTable
from testbed.core.estimation.information import Information, information_sum
from testbed.core.estimation.model_errors.estimates import (
    ModelErrorCorrection,
    ModelErrorEffect,
    ModelErrorEstimate,
    RepeatableError,
)
from testbed.core.estimation.noise.noise_model import NoiseModel
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.estimation.selection.held_out import TermChoice
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.columns import WRENCH_COMPONENTS, WRENCH_UNITS
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import joint_and_shaft_names
from testbed.core.robot.tree import Tree

METHOD_LABELS: Mapping[str, str] = {"wrench": "force plate", "torque": "joint torques"}
"""Label of each method in texts, by method."""


ROBOT_SENSOR_LABEL = "force sensor"
"""Label of a force sensor inside the robot."""


def robot_sensor_label(tree: Tree) -> str:
    """Display label of the robot's force sensor, or "" for the force plate.

    Args:
        tree: Robot whose wrench is measured.
    """
    return "" if tree.sensor is None else ROBOT_SENSOR_LABEL


def instrument_label(minimal: MinimalSet, method: Signal) -> str:
    """Label of the instrument that measured the data of a minimal set.

    Args:
        minimal: Minimal set.
        method: Method of the estimate.
    """
    return ROBOT_SENSOR_LABEL if minimal.of_sensor else METHOD_LABELS[method]


NEGLIGIBLE_FRACTION = 1e-4
"""Largest negligible residual, relative to the largest signal of the same unit."""


def channel_names(tree: Tree, method: Signal) -> tuple[str, ...]:
    """Names of a method's channels: the wrench's six components or the joints.

    Args:
        tree: Robot.
        method: Method.
    """
    return WRENCH_COMPONENTS if method == "wrench" else tree.names


def channel_units(tree: Tree, method: Signal) -> tuple[str, ...]:
    """Unit of each channel of a method, N or N m.

    Args:
        tree: Robot.
        method: Method.
    """
    if method == "wrench":
        return WRENCH_UNITS
    return tuple("N m" if joint.revolute else "N" for joint in tree.joints)


def non_negligible_residuals(
    residual: Array,
    signal: Array,
    units: Sequence[str],
    negligible_fraction: float = NEGLIGIBLE_FRACTION,
) -> tuple[bool, ...]:
    """True for each channel whose residual is not negligible.

    A residual is compared with the largest signal among the channels of its unit.

    Args:
        residual: Rms residual of each channel, (C,) [N, N m]; nan for a channel without samples.
        signal: Rms measurement of each channel, (C,) [N, N m]; nan for a channel without samples.
        units: Unit of each channel.
        negligible_fraction: Largest negligible residual, relative to the largest signal of its
            unit.
    """
    like = [[other == unit for other in units] for unit in units]
    largest = [np.nan_to_num(signal[same]).max() for same in like]
    return tuple(
        bool(r > negligible_fraction * s)
        for r, s in zip(residual, largest, strict=True)
    )


def channel_label(method: Signal, name: str) -> str:
    """Label of a channel in a sentence, such as "channel Fx".

    Args:
        method: Method of the channel.
        name: Name of the channel.
    """
    return f"channel {name}" if method == "wrench" else f"the torque of '{name}'"


@dataclass(frozen=True)
class TermEstimate:
    """Estimated coefficient of a joint law: friction, offset or rotor inertia.

    Attributes:
        law: Law of the joint torque.
        joint: Name of the joint, or of a shaft coupled to several joints.
        name: `kind/JOINT`, such as "coulomb/elbow", followed by the names of any terms regrouped
            with it.
        unit: Unit of the coefficient.
        value: Value of the coefficient.
        sigma: Standard deviation of the coefficient.
    """

    law: JointLaw
    joint: str
    name: str
    unit: str
    value: float
    sigma: float

    @property
    def kind(self) -> str:
        """Name of the law, such as "coulomb"."""
        return self.law.kind


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EstimateSummary(Gaussian):
    """Estimate by one method, without normal equations and diagnostics.

    The parameters are the minimal parameters; for joint torques, the coefficients of the joint laws
    follow. Parameters that no motion can separate from an unknown plate bias are marked
    unidentifiable; their values and covariance hold only together with that bias.

    Attributes:
        method: "wrench" (force plate) or "torque" (joint torques).
        gravity: Assumed gravity, (3,) [m/s^2], bedplate frame.
        residual: RMS residual of each of the C channels, (C,) [N, N m]; relative to its mean for
            channels with an estimated constant offset.
        nuisances: Coefficients of sensor errors estimated together with the parameters.
        settings: Settings of the estimate, including terms and filters chosen from the data.
        correction: Coefficients of the model errors subtracted from the measurements, which
            predict these errors in other recordings of the robot; None if none were subtracted.
    """

    method: Signal
    gravity: Array
    residual: Array
    nuisances: tuple[NuisanceEstimate, ...] = ()
    settings: Annotated[Settings, TableSchema()] = DEFAULTS
    correction: ModelErrorCorrection | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze_arrays(self, gravity=(3,), residual=(None,))

    @property
    def sensor_errors(self) -> dict[str, float]:
        """Estimated coefficients of sensor errors by name, such as "pose/rx"."""
        return {each.name: each.value for each in self.nuisances}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Estimate(Diagnosed, EstimateSummary):
    """Estimate by one method, with residuals, tests and diagnostics.

    Attributes:
        channels: Names of the measured channels.
        channel_units: Unit of each channel, N or N m.
        relative_residual: ||y - phi delta|| / ||y|| of each channel, (C,).
        samples: Number of rows used of each channel, (C,).
        condition: Condition number of the weighted equations with columns of unit length.
        normal_equations: Normal equations of all rows, channel by channel.
        diagnostics: Warnings and errors about data and estimate.
        minimal: Minimal set of the bodies, whose parameters come first.
        drives: Minimal set with the joint laws, for joint torques; None for the plate.
        joints: Names of the joints.
        noise: Noise model of the residuals; None for white noise.
        nuisance_covariance: Covariance of the coefficients of sensor errors, (s, s).
        choice: Joint laws chosen by cross-validation, with the evidence; None for stated laws.
        measured_equations: Normal equations of the uncorrected measurements, if model errors were
            subtracted in `normal_equations`; else None.
        model_errors: Model errors detected in the residuals, the most significant first.
        repeatable: Part of the residuals that repeats with the motion; None if not
            determined.
        model_error_effect: Contribution of model errors that `covariance` includes; None without
            model errors.
    """

    channels: tuple[str, ...]
    channel_units: tuple[str, ...]
    relative_residual: Array
    samples: tuple[int, ...]
    condition: float
    normal_equations: NormalEquations
    diagnostics: tuple[Diagnostic, ...]
    minimal: MinimalSet
    drives: DriveSet | None
    joints: tuple[str, ...]
    noise: NoiseModel | None = None
    nuisance_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    choice: TermChoice | None = None
    measured_equations: NormalEquations | None = None
    model_errors: tuple[ModelErrorEstimate, ...] = ()
    repeatable: RepeatableError | None = None
    model_error_effect: ModelErrorEffect | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        c, s = len(self.channels), len(self.nuisance_covariance)
        freeze_arrays(
            self, residual=(c,), relative_residual=(c,), nuisance_covariance=(s, s)
        )

    @cached_property
    def matters(self) -> tuple[bool, ...]:
        """Flags of channels whose RMS residual is not negligible.

        The RMS residual of such a channel exceeds 1e-4 of the largest RMS signal of the same unit.
        """
        return non_negligible_residuals(
            self.residual, self.normal_equations.rms, self.channel_units
        )

    def label(self, c: int) -> str:
        """Label of channel c in a sentence."""
        return channel_label(self.method, self.channels[c])

    @cached_property
    def base(self) -> Gaussian:
        """Marginal distribution of the minimal parameters, without separate joint laws."""
        return self.marginal(self.names[: self.minimal.count])

    @cached_property
    def joint_terms(self) -> tuple[TermEstimate, ...]:
        """Estimated coefficients of the joint laws, in their order; () for the force plate."""
        if self.drives is None:
            return ()
        names = joint_and_shaft_names(self.drives.tree)
        return tuple(
            TermEstimate(
                law=term.law,
                joint=names[term.joint],
                name=self.names[k],
                unit=self.units[k],
                value=float(self.values[k]),
                sigma=float(self.sigma[k]),
            )
            for k, term in enumerate(self.drives.terms, start=self.minimal.count)
        )

    @property
    def instrument(self) -> str:
        """Label of the instrument: force plate, force sensor or joint torques."""
        return instrument_label(self.minimal, self.method)

    def __add__(self, other: Information | Estimate) -> Information:
        """Combine with an independent estimate of the same robot by adding information matrices."""
        return information_sum((self,), other)

    @property
    def summary(self) -> SummaryTable:
        """Table of names, values with sigmas and units, followed by warnings."""
        reservation = (
            "; doubtful: its standard deviations do not include the errors that diagnostics name"
            if self.has_errors
            else ""
        )
        table = super().summary
        warnings = (f"warning: {line}" for line in sentences(self.diagnostics))
        head = f"{table.title} by the {self.instrument}{reservation}"
        return replace(table, title=head, notes=tuple(warnings))
