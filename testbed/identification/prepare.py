"""From a recording to linear equations: kinematics, regressor, and the parallel filter.

What is done to the measurement is done to every column of the regressor: the equations
stay exact, only the noise changes. A filter on positions alone would bias the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.dynamics.dynamics import regressor
from testbed.dynamics.motion import Motion
from testbed.errors import PipelineError, RecordingError
from testbed.identification.filters import STENCIL, derivatives, low_pass, settling
from testbed.measurement.recording import AXES, Recording
from testbed.parameters.minimal_set import MinimalSet
from testbed.tree.tree import Tree

ROWS_PER_CUTOFF = 4.0
"""Rows kept a second per Hz of the parallel filter's cutoff."""


@dataclass(frozen=True)
class Pipeline:
    """How a recording becomes equations.

    Attributes:
        position_cutoff: Low-pass on encoder positions before they are differentiated,
            at least twice `cutoff` [Hz]; None for none.
        cutoff: Parallel low-pass on regressor and measurement [Hz]; None for none.
        deadband: Joint rows at lower speeds are dropped: dry friction there has no sign
            [rad/s or m/s].
    """

    position_cutoff: float | None = 40.0
    cutoff: float | None = 5.0
    deadband: float = 0.02

    def __post_init__(self) -> None:
        for name in ("position_cutoff", "cutoff"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0 < value < np.inf):
                raise PipelineError(f"{name} is a positive frequency [Hz] or None, found {value}")
        if not 0 <= self.deadband < np.inf:
            raise PipelineError(f"deadband is a speed, found {self.deadband}")
        slow, fast = self.cutoff, self.position_cutoff
        if slow is not None and fast is not None and fast < 2 * slow:
            raise PipelineError(
                f"position_cutoff = {fast:g} Hz is less than twice cutoff = {slow:g} Hz: what it "
                "takes from the motion would bias the estimate"
            )


@dataclass(frozen=True, eq=False)
class Channel:
    """The equations of one measured channel: columns @ unknowns = measured.

    Attributes:
        name: "Fx" ... or the joint's name.
        columns: (M', p).
        measured: (M',).
        used: Which rows count, (M',) booleans.
    """

    name: str
    columns: Array
    measured: Array
    used: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Equations:
    """Linear equations in p unknowns.

    Attributes:
        unknowns: Their names, (p,).
        channels: One a measured channel.
        rate: Rows a second [Hz].
    """

    unknowns: tuple[str, ...]
    channels: tuple[Channel, ...]
    rate: float


def motion_of(recording: Recording, pipeline: Pipeline) -> Motion:
    """The motion that the encoders show, or that the instrument senses."""
    t, q = recording.time, recording.position
    if recording.senses_kinematics:
        assert recording.velocity is not None
        assert recording.acceleration is not None
        return Motion(t, q, recording.velocity, recording.acceleration)
    if pipeline.position_cutoff is not None:
        q = low_pass(q, recording.rate, pipeline.position_cutoff)
    return Motion(t, q, *derivatives(q, recording.rate))


def external_equations(
    tree: Tree, recording: Recording, minimal: MinimalSet, pipeline: Pipeline
) -> Equations:
    """Six rows a sample, [FRS96] eq. (12): the plate's wrench less the pedestal's.

    Args:
        tree: The robot's geometry.
        recording: Joint columns in the order of `tree.names`, with a tare.
        minimal: delta_r.
        pipeline: How to treat the signals.
    """
    assert recording.tare is not None
    keep, rate = _kept_rows(recording, pipeline)
    phi = _filtered(regressor(tree, motion_of(recording, pipeline), minimal), recording, pipeline)
    wrench = _filtered(recording.wrench - recording.tare, recording, pipeline)
    used = np.ones(len(wrench[keep]), dtype=bool)
    channels = tuple(
        Channel(axis, phi[keep, k], wrench[keep, k], used) for k, axis in enumerate(AXES)
    )
    return Equations(minimal.names, channels, rate)


def internal_equations(
    tree: Tree, recording: Recording, minimal: MinimalSet, pipeline: Pipeline
) -> Equations:
    """One row a joint and sample, [FRS96] eq. (10), with Coulomb and viscous columns.

    Unknowns: delta_d, then the Coulomb levels, then the viscous coefficients.

    Args:
        tree: The robot's geometry.
        recording: Joint columns in the order of `tree.names`.
        minimal: delta_d.
        pipeline: How to treat the signals.
    """
    keep, rate = _kept_rows(recording, pipeline)
    motion = motion_of(recording, pipeline)
    phi = _filtered(regressor(tree, motion, minimal), recording, pipeline)[keep]
    torque = _filtered(recording.torque, recording, pipeline)[keep]
    dry = _filtered(np.sign(motion.qd), recording, pipeline)[keep]
    wet = _filtered(motion.qd, recording, pipeline)[keep]
    channels = []
    for j, name in enumerate(tree.names):
        own = np.eye(tree.n)[j]
        columns = np.hstack([phi[:, j], np.outer(dry[:, j], own), np.outer(wet[:, j], own)])
        used = np.abs(motion.qd[keep, j]) > pipeline.deadband
        channels.append(Channel(name, columns, torque[:, j], used))
    friction = tuple(f"{what}/{name}" for what in ("coulomb", "viscous") for name in tree.names)
    return Equations((*minimal.names, *friction), tuple(channels), rate)


def _filtered(values: Array, recording: Recording, pipeline: Pipeline) -> Array:
    if pipeline.cutoff is None:
        return values
    return low_pass(values, recording.rate, pipeline.cutoff)


def _kept_rows(recording: Recording, pipeline: Pipeline) -> tuple[slice, float]:
    """Rows left after the ends are cut and the rest decimated, and their rate [Hz].

    Raises:
        RecordingError: The recording is too short, or sampled too slowly.
    """
    rate, sensed = recording.rate, recording.senses_kinematics
    cutoffs = [c for c in (pipeline.cutoff, None if sensed else pipeline.position_cutoff) if c]
    fast = [cutoff for cutoff in cutoffs if cutoff >= rate / 2]
    if fast:
        raise RecordingError(
            f"the recording has {rate:g} samples a second, too few for a filter at {fast[0]:g} Hz"
        )
    trim = 0 if sensed else STENCIL
    trim += int(np.ceil(max((settling(cutoff) for cutoff in cutoffs), default=0.0) * rate))
    step = 1 if pipeline.cutoff is None else int(rate / (ROWS_PER_CUTOFF * pipeline.cutoff)) or 1
    rows = len(range(trim, recording.samples - trim, step))
    if rows < 2:
        raise RecordingError(
            f"the recording lasts {recording.samples / rate:.3g} s, too short: the filters take "
            f"{trim / rate:.3g} s at each end; record longer or raise the cutoff frequencies"
        )
    return slice(trim, recording.samples - trim, step), rate / step
