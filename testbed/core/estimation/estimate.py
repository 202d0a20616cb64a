"""What one method found, with its structure: values, sigmas, residuals, as values and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.codec import TableSchema
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, sentences
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.summary_table import SummaryTable
from testbed.core.estimation.information import Information, added
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
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.shafts import places
from testbed.core.robot.tree import Tree

Method = Literal["external", "internal"]

METHODS: tuple[Method, ...] = ("external", "internal")
"""By the bedplate's wrench, and by the joint torques."""

NAMES: Mapping[str, str] = {"external": "force plate", "internal": "joint torques"}
"""What people call the methods."""

SIGNAL_OF: Mapping[Method, Signal] = {"external": "wrench", "internal": "torque"}
"""What a method needs of a recording besides positions."""


SENSOR = "force sensor"
"""What people call one that is in the robot."""


def sensor_of(tree: Tree) -> str:
    """What a person calls the force sensor that is not the plate; "" for the plate.

    Args:
        tree: What the wrench is of.
    """
    return "" if tree.sensor is None else SENSOR


def instrument_of(minimal: MinimalSet, method: Method) -> str:
    """What a person calls that by which a minimal set was measured.

    Args:
        minimal: The set.
        method: By which it was estimated.
    """
    return SENSOR if minimal.of_sensor else NAMES[method]


MATTERS = 1e-4
"""Part of the like channels' signals below which a residual is of no matter."""


def channels_of(tree: Tree, method: Method) -> tuple[str, ...]:
    """What a method measures: the plate's six components, or the joints' torques.

    Args:
        tree: The robot.
        method: Which.
    """
    return AXES if method == "external" else tree.names


def channel_units(tree: Tree, method: Method) -> tuple[str, ...]:
    """N or N m, one a channel.

    Args:
        tree: The robot.
        method: Which channels are meant.
    """
    if method == "external":
        return PLATE_UNITS
    return tuple("N m" if joint.revolute else "N" for joint in tree.joints)


def matters(
    residual: Array, signal: Array, units: Sequence[str], part: float = MATTERS
) -> tuple[bool, ...]:
    """Whether residuals are large enough to matter among channels of the same unit.

    Args:
        residual: Rms of each channel's, (C,) [N, N m]; nan where there is none.
        signal: Rms of each channel, (C,) [N, N m]; nan where there is none.
        units: One a channel.
        part: Of the largest like signal beyond which a residual matters.
    """
    like = [[other == unit for other in units] for unit in units]
    largest = [np.nan_to_num(signal[same]).max() for same in like]
    return tuple(bool(r > part * s) for r, s in zip(residual, largest, strict=True))


def channel_label(method: Method, name: str) -> str:
    """What a channel is called in a sentence.

    Args:
        method: Whose.
        name: Of the channel.
    """
    return f"channel {name}" if method == "external" else f"the torque of '{name}'"


@dataclass(frozen=True)
class TermEstimate:
    """One coefficient of a law of a joint's own torque.

    Attributes:
        law: Which law.
        joint: The joint's name, or that of a shaft that turns with several.
        name: `kind/JOINT`; another term of the joint that it takes up is named in it.
        unit: Of the coefficient.
        value: The coefficient.
        sigma: Its standard deviation.
    """

    law: JointLaw
    joint: str
    name: str
    unit: str
    value: float
    sigma: float

    @property
    def kind(self) -> str:
        """The law's name."""
        return self.law.kind


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EstimateSummary(Gaussian):
    """Estimate by one method, without the data that it was made from.

    Its parameters are the minimal ones; then, for the internal method, the joints' own terms.
    Those that no motion separates from the plate's zero, which is not known, are not identifiable:
    values and covariance hold together with that zero only.

    Attributes:
        method: "external" (bedplate) or "internal" (joint torques).
        gravity: That was assumed, (3,) [m/s^2], bedplate frame.
        residual: Rms residual of every channel, (channels,) [N, N m]; about its mean where the
            channel has a constant of its own.
        nuisances: Coefficients of sensor errors that were estimated with the parameters.
        settings: How its recording became equations, with all that data chose.
        correction: Model errors that every recording has; None for none.
    """

    method: Method
    gravity: Array
    residual: Array
    nuisances: tuple[NuisanceEstimate, ...] = ()
    settings: Annotated[Settings, TableSchema()] = DEFAULTS
    correction: ModelErrorCorrection | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, gravity=(3,), residual=(None,))

    @property
    def sensor_errors(self) -> dict[str, float]:
        """Coefficients of sensor errors by name, such as "pose/rx"."""
        return {each.name: each.value for each in self.nuisances}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Estimate(Diagnosed, EstimateSummary):
    """Estimate by one method, with residuals, tests and diagnostics.

    Attributes:
        channels: The measured channels.
        channel_units: One each, N or N m.
        relative_residual: ||y - phi delta|| / ||y|| of each, (channels,).
        samples: Rows used of each, (channels,).
        condition: Of the equations with unit columns and weights.
        normal_equations: Of all rows: other weights and subsets of channels need no other pass.
        diagnostics: What a careful reader should know; errors where the data contradict the model.
        minimal: The minimal set that comes first.
        drives: That set with the joints' own terms, for the internal method.
        joints: The joints' names.
        noise: What the residuals are like; None where they are taken as white.
        nuisance_covariance: Of the coefficients of sensor errors, (s, s).
        choice: How held-out data chose the joints' terms, where they did.
        measured_equations: Of rows as measured, where model errors are taken out of the others.
        model_errors: Errors of the model that the residuals show, the clearest first.
        repeatable: Part of the residuals that repeats with the motion; None where nothing is known.
        model_error_effect: What they add to the covariance, which counts it; None for nothing.
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
        freeze(self, residual=(c,), relative_residual=(c,), nuisance_covariance=(s, s))

    @cached_property
    def matters(self) -> tuple[bool, ...]:
        """Whether each channel's residual is large enough to matter among like channels."""
        return matters(self.residual, self.normal_equations.rms, self.channel_units)

    def label(self, c: int) -> str:
        """What a channel is called in a sentence."""
        return channel_label(self.method, self.channels[c])

    @cached_property
    def base(self) -> Gaussian:
        """The minimal parameters alone; a joint's term that is part of one is named in it."""
        return self.marginal(self.names[: self.minimal.count])

    @cached_property
    def joint_terms(self) -> tuple[TermEstimate, ...]:
        """The joints' own terms, law by law; none for the external method."""
        if self.drives is None:
            return ()
        names = places(self.drives.tree)
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
        """What it was measured by."""
        return instrument_of(self.minimal, self.method)

    def __add__(self, other: Information | Estimate) -> Information:
        """Sum of what both say; independent data of one robot (`Information`)."""
        return added((self,), other)

    @property
    def summary(self) -> SummaryTable:
        """Names, values with sigmas, units, warnings."""
        doubt = (
            "; doubtful: its standard deviations do not include the errors that diagnostics name"
            if self.doubtful
            else ""
        )
        table = super().summary
        warnings = (f"warning: {line}" for line in sentences(self.diagnostics))
        head = f"{table.head} by the {self.instrument}{doubt}"
        return replace(table, head=head, notes=tuple(warnings))
