"""What one method found, with its structure: values, sigmas, residuals, as values and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from testbed.core.base.arrays import Array, freeze
from testbed.core.base.codec import TableSchema
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, sentences
from testbed.core.base.errors import plural
from testbed.core.base.frames import frame_of
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows
from testbed.core.estimation.information import Information
from testbed.core.estimation.noise.noise_model import NoiseModel
from testbed.core.estimation.regression.normal_equations import NormalEquations
from testbed.core.estimation.selection.held_out import TermChoice
from testbed.core.estimation.sensor.estimates import NuisanceEstimate, TraceTest
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.rules import Model, Signal
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


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """The minimal parameters of an estimate.

    Attributes:
        model: "reaction" (delta_r) or "dynamic" (delta_d).
        names: One a parameter; a joint's term that cannot be distinguished from it is named in it.
        units: One each.
        values: (N,).
        sigma: Standard deviations, (N,).
        covariance: (N, N).
        matrix: Those on the 10 n barycentric parameters, (N, 10 n).
    """

    model: Model
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    covariance: Array
    matrix: Array


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


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Diagnosed, Summarized):
    """What one method found.

    Attributes:
        method: "external" (bedplate) or "internal" (joint torques).
        names: The minimal parameters; then, for the internal method, the joints' own terms.
        units: One each.
        values: (p,).
        sigma: Standard deviations, (p,), correlation of residuals counted; infinite for those
            that are `unidentifiable`.
        covariance: (p, p); of those that are `unidentifiable`, as if the plate's zero were right.
        gravity: That was assumed, (3,) [m/s^2], bedplate frame.
        channels: The measured channels.
        channel_units: One each, N or N m.
        residual: Rms of their residuals, (channels,) [N, N m]; about their mean where the
            channel has a constant of its own.
        relative_residual: ||y - phi delta|| / ||y|| of each, (channels,).
        samples: Rows used of each, (channels,).
        condition: Of the equations with unit columns and weights.
        normal_equations: Of all rows: other weights and subsets of channels need no other pass.
        diagnostics: What a careful reader should know; errors where the data contradict the model.
        minimal: The minimal set that comes first.
        drives: That set with the joints' own terms, for the internal method.
        joints: The joints' names.
        noise: What the residuals are like; None where they are taken as white.
        nuisances: Numbers of the instrument that were estimated with the parameters.
        trace_tests: Faults of the instrument whose traces were looked for in the residuals.
        nuisance_covariance: Of the instrument's numbers, (s, s).
        choice: How held-out data chose the joints' terms, where they did.
        unidentifiable: Names of parameters that no motion separates from the plate's zero, which is
            not known here. Their values hold together with that zero only.
        settings: How its recording became equations, with all that data chose.
    """

    method: Method
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    covariance: Array
    gravity: Array
    channels: tuple[str, ...]
    channel_units: tuple[str, ...]
    residual: Array
    relative_residual: Array
    samples: tuple[int, ...]
    condition: float
    normal_equations: NormalEquations
    diagnostics: tuple[Diagnostic, ...]
    minimal: MinimalSet
    drives: DriveSet | None
    joints: tuple[str, ...]
    noise: NoiseModel | None = None
    nuisances: tuple[NuisanceEstimate, ...] = ()
    trace_tests: tuple[TraceTest, ...] = ()
    nuisance_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    choice: TermChoice | None = None
    unidentifiable: tuple[str, ...] = ()
    settings: Annotated[Settings, TableSchema()] = DEFAULTS

    def __post_init__(self) -> None:
        p, c = len(self.names), len(self.channels)
        s = len(self.nuisance_covariance)
        freeze(self, values=(p,), sigma=(p,), covariance=(p, p), gravity=(3,))
        freeze(self, residual=(c,), relative_residual=(c,), nuisance_covariance=(s, s))

    def without(self, unidentifiable: Sequence[str]) -> Estimate:
        """The same, some of the parameters said to be not identifiable.

        Args:
            unidentifiable: Their names.
        """
        unknown = [name in unidentifiable for name in self.names]
        sigma = np.where(unknown, np.inf, self.sigma)
        return replace(self, sigma=sigma, unidentifiable=tuple(unidentifiable))

    @cached_property
    def matters(self) -> tuple[bool, ...]:
        """Whether each channel's residual is large enough to matter among like channels."""
        return matters(self.residual, self.normal_equations.rms, self.channel_units)

    def label(self, c: int) -> str:
        """What a channel is called in a sentence."""
        return channel_label(self.method, self.channels[c])

    @cached_property
    def base(self) -> BaseEstimate:
        """The minimal parameters alone."""
        own = slice(0, self.minimal.count)
        return BaseEstimate(
            model=self.minimal.model,
            names=self.names[own],
            units=self.units[own],
            values=self.values[own],
            sigma=self.sigma[own],
            covariance=self.covariance[own, own],
            matrix=self.minimal.matrix,
        )

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
        return Information((self,)).__add__(other)

    @property
    def summary(self) -> SummaryTable:
        """Names, values with sigmas, units, warnings."""
        doubt = (
            "; doubtful: its standard deviations do not include the errors that diagnostics name"
            if self.doubtful
            else ""
        )
        head = f"{plural(len(self.names), 'parameter')} by the {self.instrument}{doubt}"
        rows = parameter_rows(self.names, self.values, self.sigma, self.units)
        warnings = (f"warning: {line}" for line in sentences(self.diagnostics))
        return SummaryTable(head, rows, tuple(warnings))

    def to_frame(self) -> Any:
        """Names, values, sigmas and units as a frame of pandas, polars or Arrow."""
        columns = {
            "name": list(self.names),
            "value": self.values.tolist(),
            "sigma": self.sigma.tolist(),
            "unit": list(self.units),
        }
        return frame_of(columns)
