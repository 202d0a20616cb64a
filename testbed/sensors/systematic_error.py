"""Base classes of systematic sensor errors, which can be simulated, estimated and corrected.

The function `effect` maps the signal without the error to the signal with the error. Simulation,
regressor columns (central differences with respect to the coefficients) and correction of a
recording (fixed-point iteration) follow from `effect`, unless a class overrides them with formulas.

Time is measured from the first sample in a simulation, but from the middle of the recording in
estimates and corrections. For example, a simulated gain 1 + r t in a recording of T seconds is
estimated as a gain of 1 + r T / 2 that grows at the rate r / (1 + r T / 2).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import WRENCH_COMPONENTS, WRENCH_UNITS
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_table import MEMBER_COUNTS
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import SensorError, Signal

COEFFICIENT_STEP = 1e-3
"""Step of a coefficient for central differences."""

TIME_STEP = 1e-3
"""Time step for differences along a motion [s]."""

MAX_ITERATIONS, CONVERGENCE_TOLERANCE = 60, 1e-13
"""Largest number of iterations in the correction of a signal, and largest final change relative to
the signal."""


class Coefficient(NamedTuple):
    """Unknown coefficient of a systematic error.

    Attributes:
        name: Name, such as "pose/rx".
        unit: Unit.
        neutral: Value for a sensor without the error.
    """

    name: str
    unit: str
    neutral: float = 0.0


class SystematicError(SensorError):
    """Sensor error that is a function of the signal, the time and a few coefficients."""

    fixed: ClassVar[tuple[Coefficient, ...]] = ()
    """Coefficients that are the same for every robot."""
    term: ClassVar[str]
    """Name among the unknowns of an estimate: the part of coefficient names before the slash; by
    default the kind."""
    remedy: ClassVar[str] = ""
    """Recommended remedy; by default the estimation of the coefficients."""
    estimated: ClassVar[bool] = True
    """True if the coefficients can be unknowns of an estimate; otherwise they are only tested."""
    estimated_as: ClassVar[str] = ""
    """Term that is estimated instead of this term; by default the same term."""
    tested: ClassVar[bool] = True
    """True if the residuals of all estimates are tested for this error as a likely cause."""
    of_one_recording: ClassVar[bool] = False
    """True if the coefficients differ between recordings."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Terms of simpler errors whose effects are special cases of this effect."""
    jointly: ClassVar[bool] = False
    """True if the coefficients are used only if all of them are identifiable."""
    added: ClassVar[bool] = False
    """True if the effect is added to the measured channels, before their unmixing."""
    unfolded: ClassVar[bool] = False
    """True if the columns require enough instants to avoid aliasing of encoder noise, as for a
    constant joint error. Columns of other errors would correlate with this noise in the rows."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "kind" in cls.__dict__ and "term" not in cls.__dict__:
            cls.term = cls.kind

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Coefficients of the error on a robot, (k,).

        Args:
            tree: The robot, with names and kinds of its joints and cuts at force sensors.
        """
        del tree
        return cls.fixed

    @property
    def values(self) -> Array:
        """Values of the coefficients, (k,), or a single value; by default the keys' values."""
        values = []
        for name, key in self.known_keys().items():
            value = np.atleast_1d(np.asarray(getattr(self, name), dtype=float))
            values.append(
                np.broadcast_to(value, MEMBER_COUNTS.get(key.members, len(value)))
            )
        return np.concatenate(values)

    @classmethod
    @abstractmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Signal with the error, computed from the signal without the error.

        Args:
            signal: Signal without the error, (M, c).
            time: Times since the first sample or relative to the middle, (M,) [s].
            values: Values of the coefficients, (k,).
        """

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with the error, (M, c), for the simulation."""
        del rng
        return self.effect(signal, time, self.values)

    @classmethod
    def neutral(cls, tree: Tree) -> Array:
        """Values of the coefficients for a sensor without the error, (k,)."""
        return np.array([coefficient.neutral for coefficient in cls.coefficients(tree)])

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative of `effect` with respect to the coefficients, (M, c, k).

        By default, the derivative is computed by central differences with steps of
        `COEFFICIENT_STEP`.

        Args:
            signal: Signal without the error, (M, c).
            time: Times of the samples, (M,) [s].
            neutral: Values of the coefficients for a sensor without the error, (k,).
        """
        columns = [
            cls.effect(signal, time, neutral + step)
            - cls.effect(signal, time, neutral - step)
            for step in COEFFICIENT_STEP * np.eye(len(neutral))
        ]
        return np.stack(columns, axis=-1) / (2 * COEFFICIENT_STEP)

    @classmethod
    def corrected_signal(cls, signal: Array, time: Array, values: Array) -> Array:
        """Signal without the error, (M, c): the inverse of `effect`.

        By default, the inverse is computed by fixed-point iteration, until a change is at most
        `CONVERGENCE_TOLERANCE` times the signal, with at most `MAX_ITERATIONS` iterations.

        Args:
            signal: Signal with the error, (M, c).
            time: Times of the samples, (M,) [s].
            values: Values of the coefficients, (k,).
        """
        estimate, size = signal, np.abs(signal).max(initial=0.0)
        for _ in range(MAX_ITERATIONS):
            change = signal - cls.effect(estimate, time, values)
            estimate = estimate + change
            if np.abs(change).max(initial=0.0) <= CONVERGENCE_TOLERANCE * size:
                break
        return estimate

    @classmethod
    def corrected_recording(
        cls, recording: Recording, values: Array, time: Array, tree: Tree
    ) -> Recording:
        """Recording corrected for the error.

        Args:
            recording: Recording with the error.
            values: Values of the coefficients, (k,).
            time: Times of the samples, relative to the middle of the whole recording, (M,) [s].
            tree: The robot.
        """
        del tree
        changed: Any = {
            cls.signal: cls.corrected_signal(
                recording.measured(cls.signal), time, values
            )
        }
        return replace(recording, **changed)

    @classmethod
    def lost_sample_count(cls, values: Array, rate: float) -> int:
        """Number of samples at each end of a recording that cannot be corrected.

        Args:
            values: Values of the coefficients, (k,).
            rate: Sampling rate [Hz].
        """
        del values, rate
        return 0

    @classmethod
    @abstractmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the residual wrench with respect to the coefficients, (rows, 6, k).

        The residual is the filtered measured wrench minus the filtered predicted wrench, at the
        rows.

        Args:
            predicted: Wrench and motion predicted by an estimate.
        """

    @classmethod
    def columns_from_measured(cls, predicted: PredictedWrench) -> Array:
        """Regressor columns from the measured wrench where possible, (rows, 6, k).

        Encoder noise affects both the predicted wrench and the residual. Columns from the predicted
        wrench therefore give biased estimates of weakly identifiable coefficients. By default, the
        columns are those of `regressor_columns`.

        Args:
            predicted: Predicted and measured wrench.
        """
        return cls.regressor_columns(predicted)

    @classmethod
    def unmixing_matrix(cls, values: Array) -> Array | None:
        """Inverse of the matrix that mixes the plate's channels, (6, 6); None without mixing.

        Args:
            values: Values of the coefficients, (k,).
        """
        del values
        return None


class PlateError(SystematicError):
    """Systematic error of a plate's wrench that is slow compared with the filter on rows."""

    signal: ClassVar[Signal] = "wrench"

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the error of the predicted wrench, (rows, 6, k).

        The derivative is taken with respect to the coefficients at their neutral values.
        """
        neutral = cls.neutral(predicted.tree)
        return cls.derivative(predicted.wrench, predicted.time, neutral)

    @classmethod
    def columns_from_measured(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the error of the measured wrench, (rows, 6, k).

        The derivative is taken with respect to the coefficients at their neutral values.
        """
        return cls.derivative(
            predicted.measured_wrench, predicted.time, cls.neutral(predicted.tree)
        )


class EncoderError(SystematicError):
    """Systematic error of joint positions, with separate coefficients for each joint."""

    signal: ClassVar[Signal] = "position"
    per_joint: ClassVar[tuple[str, ...]] = ("",)
    """Suffixes of the names of a joint's coefficients."""
    units: ClassVar[tuple[str, str]]
    """Units of a coefficient for a revolute and for a prismatic joint."""
    of_revolute: ClassVar[bool] = False
    """True if only revolute joints have coefficients."""

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Coefficients of all joints, joint by joint."""
        return tuple(
            Coefficient(f"{cls.term}/{joint.name}{end}", cls.units[not joint.revolute])
            for joint in tree.joints
            if joint.revolute or not cls.of_revolute
            for end in cls.per_joint
        )

    @classmethod
    def coordinate_errors(
        cls, q: Array, qd: Array, qdd: Array
    ) -> Iterable[tuple[Any, Any, Any]]:
        """Derivatives of a joint's motion with respect to each coefficient.

        By default, they are computed from differences of `effect` along the motion, with steps of
        `TIME_STEP`.

        Args:
            q: Joint position, (m,) [rad or m].
            qd: Joint velocity, (m,) [rad/s or m/s].
            qdd: Joint acceleration, (m,) [rad/s^2 or m/s^2].

        Returns:
            For each coefficient, the derivatives of position, velocity and acceleration with
            respect to this coefficient, each (m,) or a number.
        """
        derivatives = []
        for h in (-TIME_STEP, 0.0, TIME_STEP):
            signal = (q + h * qd + h**2 / 2 * qdd)[:, None]
            neutral = np.zeros(len(cls.per_joint))
            derivatives.append(
                cls.derivative(signal, np.full(len(q), h), neutral)[:, 0].T
            )
        before, centre, after = derivatives
        rate = (after - before) / (2 * TIME_STEP)
        return zip(
            centre, rate, (after - 2 * centre + before) / TIME_STEP**2, strict=True
        )

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the residual wrench with respect to the coefficients, (rows, 6, k).

        The residual is the measured wrench minus the wrench predicted at the measured positions.
        """
        motion = predicted.motion
        signals = [np.zeros((motion.samples, 6, 0))]
        for j, joint in enumerate(predicted.tree.joints):
            if joint.revolute or not cls.of_revolute:
                joint_motion = (
                    each[:, j] for each in (motion.q, motion.qd, motion.qdd)
                )
                errors = cls.coordinate_errors(*joint_motion)
                signals += [
                    -predicted.coordinate_derivative(j, *each)[..., None]
                    for each in errors
                ]
        return predicted.filter_signals(np.concatenate(signals, axis=2))


class ClockError(SystematicError):
    """Systematic error of the instants at which the plate is sampled."""

    signal: ClassVar[Signal] = "wrench"

    @classmethod
    @abstractmethod
    def delay_derivative(cls, time: Array) -> Array | float:
        """Derivative of the plate's delay [s] with respect to the coefficient, (M,) or a number."""

    @classmethod
    def regressor_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the measured wrench with respect to a delay's coefficient, (rows, 6, 1).

        The result is the negative time derivative of the predicted wrench, multiplied by the
        derivative of the delay.
        """
        delay_derivative = np.broadcast_to(
            cls.delay_derivative(predicted.time), len(predicted.time)
        )
        return np.asarray(
            -predicted.filter_derivatives(predicted.robot_wrench[..., None])
            * delay_derivative[:, None, None]
        )


def channel_coefficients(
    prefix: str, units: Sequence[str] = WRENCH_UNITS
) -> tuple[Coefficient, ...]:
    """Coefficients of the plate's six channels.

    Args:
        prefix: Part of the names before the slash.
        units: Unit of each coefficient.
    """
    names = (f"{prefix}/{axis}" for axis in WRENCH_COMPONENTS)
    return tuple(map(Coefficient, names, units))
