"""Systematic sensor errors as families of model errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import cause_phrase
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.parameters.rules import SIGNALS
from testbed.core.robot.tree import Tree
from testbed.sensors.errors.encoder_delay import EncoderDelay
from testbed.sensors.errors.sampling_rate import SamplingRate
from testbed.sensors.systematic_error import (
    ClockError,
    EncoderError,
    PlateError,
    SystematicError,
)

SAMPLING_ERROR = 1e-3
"""Plausible relative error of the time between samples."""


class SensorFamily(ModelErrorFamily):
    """Systematic sensor error as a family of model errors.

    The default values of the error's fields are the plausible sizes of its coefficients.
    """

    def __init__(self, error: type[SystematicError]) -> None:
        """Build the family of one sensor error.

        Args:
            error: Error of the encoders, of the force plate, or of the clock.
        """
        self.error = error
        self.kind = error.term
        self.label = self.meaning = cause_phrase(error.term)
        setting = f"--set 'identification.nuisances=[\"{error.term}\"]'"
        self.remedy = error.remedy or f"estimate it with the parameters: {setting}"
        plate = issubclass(error, PlateError | ClockError)
        self.methods = ("wrench",) if plate else SIGNALS
        self.lasting = not error.of_one_recording

    def coefficient_scales(self, tree: Tree) -> Sequence[tuple[str, str, float]]:
        """Names, units and plausible sizes of the error's coefficients.

        Sizes are the absolute default values, or SAMPLING_ERROR for the sampling rate.
        """
        coefficients = self.error.coefficients(tree)
        sizes = np.full(len(coefficients), SAMPLING_ERROR)
        if self.error is not SamplingRate:
            sizes = _plausible_sizes(self.error, len(coefficients))
        pairs = zip(coefficients, sizes.tolist(), strict=True)
        return [(each.name, each.unit, size) for each, size in pairs]

    def columns(self, point: Linearization) -> Array:
        """Effects of the coefficients on the measurements, (m, C, k) [N, N m].

        Errors of the encoders change the positions used for the prediction, errors of the plate
        change the wrench, and errors of the clock change the instants of the wrench. An error of
        the sampling rate scales velocities and accelerations.
        """
        if issubclass(self.error, EncoderError):
            return self._encoder_effects(point, self.error)
        if issubclass(self.error, PlateError):
            neutral = self.error.neutral(point.tree)
            effects = self.error.derivative(point.forces.wrench, point.time, neutral)
            return effects * _plausible_sizes(self.error, effects.shape[2])
        if issubclass(self.error, ClockError):
            delay = np.broadcast_to(
                self.error.delay_derivative(point.time), len(point.time)
            )
            rate = point.time_derivative(point.forces.wrench) * delay[:, None]
            return np.asarray(-_plausible_sizes(self.error, 1) * rate[..., None])
        assert issubclass(self.error, SamplingRate)
        joints = point.slopes.select(slice(point.tree.n))
        zeros = np.zeros_like(point.motion.qd)[..., None]
        change = joints.force_changes(
            zeros, point.motion.qd[..., None], 2 * point.motion.qdd[..., None]
        )
        return np.asarray(-SAMPLING_ERROR * change.sum(axis=2))

    def _encoder_effects(
        self, point: Linearization, error: type[EncoderError]
    ) -> Array:
        """Effects of position errors of each joint, (m, C, k).

        The forces are measured at the true positions and predicted at the positions with errors.
        Errors of revolute joints have no columns for prismatic joints.
        """
        slopes, motion = point.slopes, point.motion
        if error is EncoderDelay:
            return point.encoder_effects(
                _plausible_sizes(error, 1) * motion.qd[..., None]
            )
        size = _plausible_sizes(error, len(error.per_joint))[: len(error.per_joint)]
        columns = []
        for j, joint in enumerate(point.tree.joints):
            if not joint.revolute and error.of_revolute:
                continue
            motion_of_joint = (each[:, j] for each in (motion.q, motion.qd, motion.qdd))
            for part, errors in zip(
                size, error.coordinate_errors(*motion_of_joint), strict=True
            ):
                each = (np.broadcast_to(e, motion.samples) for e in errors)
                change = slopes.select(slice(j, j + 1)).force_changes(
                    *(e[:, None, None] for e in each)
                )
                columns.append(-part * change[:, :, 0, 0])
        return np.stack(columns, axis=2)


def _plausible_sizes(error: type[SystematicError], count: int) -> Array:
    """Plausible sizes of the coefficients, from the default values of the error, (count,)."""
    values = np.abs(error(**_phase_argument(error)).values)
    return np.resize(values, count)


def _phase_argument(error: type[SystematicError]) -> dict[str, float]:
    """Keyword argument for a phase of pi/4; empty for an error without phase."""
    names = {each.name for each in fields(error)}
    return {"phase": np.pi / 4} if "phase" in names else {}
