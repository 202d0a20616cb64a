"""What one method found, with its structure: minimal parameters, then the joints' own terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any, Literal

import numpy as np

from testbed.arrays import Array, readonly
from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, sentences
from testbed.errors import TestbedError, plural
from testbed.identification.estimate_text import Words
from testbed.identification.noise.noise_model import NoiseModel
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.identification.selection.held_out import TermChoice
from testbed.identification.sensor.estimates import NuisanceEstimate, TraceTest
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet
from testbed.parameters.rules import Model
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.robot.friction import JointLaw
from testbed.robot.transmission import places
from testbed.robot.tree import Tree

Method = Literal["external", "internal"]

METHODS: tuple[Method, ...] = ("external", "internal")
"""By the bedplate's wrench, and by the joint torques."""

MODEL_OF: Mapping[Method, Model] = {"external": "reaction", "internal": "dynamic"}
"""Which of the two minimal sets a method sees."""

SIGNAL_OF: Mapping[Method, str] = {"external": "wrench", "internal": "torque"}
"""What a method needs of a recording besides positions."""


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


def matters(residual: Array, signal: Array, units: Sequence[str]) -> tuple[bool, ...]:
    """Whether residuals are large enough to matter among channels of the same unit.

    Args:
        residual: Rms of each channel's, (C,) [N, N m]; nan where there is none.
        signal: Rms of each channel, (C,) [N, N m]; nan where there is none.
        units: One a channel.
    """
    like = [[other == unit for other in units] for unit in units]
    largest = [np.nan_to_num(signal[same]).max() for same in like]
    return tuple(bool(r > MATTERS * s) for r, s in zip(residual, largest, strict=True))


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
        names: One a parameter; a joint's term that cannot be told from it is named in it.
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
class Estimate(Diagnosed):
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
        nuisance_cross: Of the parameters with them, (p, s).
        choice: How held-out data chose the joints' terms, where they did.
        unidentifiable: Names of parameters that no motion tells from the plate's zero, which is
            not known here. Their values hold together with that zero only.
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
    nuisance_cross: Array = field(default_factory=lambda: np.zeros((0, 0)))
    choice: TermChoice | None = None
    unidentifiable: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        p, c = len(self.names), len(self.channels)
        shapes = {"values": (p,), "sigma": (p,), "covariance": (p, p), "gravity": (3,)}
        shapes |= {"residual": (c,), "relative_residual": (c,)}
        s = len(self.nuisance_covariance)
        shapes["nuisance_covariance"] = (s, s)
        shapes["nuisance_cross"] = (p if s else len(self.nuisance_cross), s)
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))

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
    def words(self) -> Words:
        """What is printed of it."""
        source = "the bedplate" if self.method == "external" else "joint torques"
        doubt = "; doubtful: sigma does not count what the diagnostics say" if self.doubtful else ""
        numbers = zip(
            self.names, self.values.tolist(), self.sigma.tolist(), self.units, strict=True
        )
        head = f"{plural(len(self.names), 'parameter')} from {source}{doubt}"
        return Words(head, tuple(numbers), sentences(self.diagnostics))

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """A table for people: names, values with sigmas, units, warnings."""
        return self.words.text()

    def _repr_html_(self) -> str:
        """The same for notebooks."""
        return self.words.html()

    def to_dict(self) -> dict[str, dict[str, float | str]]:
        """Value, sigma and unit by name; sigma is infinite where a value is not identifiable."""
        numbers = zip(self.values.tolist(), self.sigma.tolist(), self.units, strict=True)
        return {
            name: {"value": value, "sigma": sigma, "unit": unit}
            for name, (value, sigma, unit) in zip(self.names, numbers, strict=True)
        }

    def to_frame(self) -> Any:
        """Names, values, sigmas and units as a data frame of pandas, or of polars.

        Raises:
            TestbedError: Neither is installed.
        """
        columns = {
            "name": list(self.names),
            "value": self.values.tolist(),
            "sigma": self.sigma.tolist(),
            "unit": list(self.units),
        }
        for package in ("pandas", "polars"):
            try:
                return import_module(package).DataFrame(columns)
            except ModuleNotFoundError:
                continue
        raise TestbedError("data frames need pandas or polars; pip install pandas")
