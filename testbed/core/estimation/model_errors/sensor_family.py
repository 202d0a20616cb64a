"""Systematic errors of sensors as families of model errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import phrase
from testbed.core.estimation.estimate import METHODS
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.robot.tree import Tree
from testbed.sensors.errors.encoder_delay import EncoderDelay
from testbed.sensors.errors.sampling_rate import SamplingRate
from testbed.sensors.systematic_error import (
    ClockError,
    EncoderError,
    PlateError,
    SystematicError,
)

SAMPLING = 1e-3
"""Plausible relative error of the time between samples."""


class SensorFamily(ModelErrorFamily):
    """Systematic error of a sensor; its keys' defaults are the plausible size."""

    def __init__(self, error: type[SystematicError]) -> None:
        """Family of one error.

        Args:
            error: Of positions, of the plate, or of its clock.
        """
        self.error = error
        self.kind = error.term
        self.label = self.meaning = phrase(error.term)
        ours = f"--set 'identification.nuisances=[\"{error.term}\"]'"
        self.remedy = error.remedy or f"estimate it with the parameters: {ours}"
        plate = issubclass(error, PlateError | ClockError)
        self.methods = ("external",) if plate else METHODS
        self.lasting = not error.of_one_recording

    def numbers(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Coefficients of the error."""
        coefficients = self.error.coefficients(tree)
        sizes = np.full(len(coefficients), SAMPLING)
        if self.error is not SamplingRate:
            sizes = _sizes(self.error, len(coefficients))
        pairs = zip(coefficients, sizes.tolist(), strict=True)
        return [(each.name, each.unit, size) for each, size in pairs]

    def columns(self, at: Linearization) -> Array:
        """Effects on what is measured, (m, C, k) [N, N m]."""
        if issubclass(self.error, EncoderError):
            return self._of_encoders(at, self.error)
        if issubclass(self.error, PlateError):
            neutral = self.error.neutral(at.tree)
            effects = self.error.derivative(at.forces.wrench, at.time, neutral)
            return effects * _sizes(self.error, effects.shape[2])
        if issubclass(self.error, ClockError):
            late = np.broadcast_to(self.error.lateness(at.time), len(at.time))
            rate = at.rate(at.forces.wrench) * late[:, None]
            return np.asarray(-_sizes(self.error, 1) * rate[..., None])
        assert issubclass(self.error, SamplingRate)
        joints = at.slopes.of(slice(at.tree.n))
        still = np.zeros_like(at.motion.qd)[..., None]
        change = joints.along(
            still, at.motion.qd[..., None], 2 * at.motion.qdd[..., None]
        )
        return np.asarray(-SAMPLING * change.sum(axis=2))

    def _of_encoders(self, at: Linearization, error: type[EncoderError]) -> Array:
        """Effects of errors of each joint's position, (m, C, k).

        Forces are measured; at the positions that are shown others are predicted.
        """
        slopes, motion = at.slopes, at.motion
        if error is EncoderDelay:
            return at.encoders(_sizes(error, 1) * motion.qd[..., None])
        size = _sizes(error, len(error.per_joint))[: len(error.per_joint)]
        columns = []
        for j, joint in enumerate(at.tree.joints):
            if not joint.revolute and error.of_revolute:
                continue
            own = (each[:, j] for each in (motion.q, motion.qd, motion.qdd))
            for part, errors in zip(size, error.coordinate_errors(*own), strict=True):
                each = (np.broadcast_to(e, motion.samples) for e in errors)
                change = slopes.of(slice(j, j + 1)).along(
                    *(e[:, None, None] for e in each)
                )
                columns.append(-part * change[:, :, 0, 0])
        return np.stack(columns, axis=2)


def _sizes(error: type[SystematicError], count: int) -> Array:
    """Plausible sizes of coefficients, (count,): the defaults of the error's keys."""
    values = np.abs(error(**_phases(error)).values)
    return np.resize(values, count)


def _phases(error: type[SystematicError]) -> dict[str, float]:
    """A phase where one is drawn otherwise."""
    known = {each.name for each in fields(error)}
    return {"phase": np.pi / 4} if "phase" in known else {}
