"""Systematic error: a sensor error with coefficients, simulated, estimated and taken back.

One function, `effect`, says what a sensor shows; the rest follows from it unless a class has
formulas of its own: the simulation, the regressor columns (central differences by the
coefficients), the correction of a recording (fixed-point iteration).

Time is from the first sample on in a simulation, from the middle of the recording on in estimates
and corrections: gains that grow by r (1/s) from time 0 in T seconds are a gain of 1 + r T / 2,
which grows by r / (1 + r T / 2).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_table import COUNTS
from testbed.sensors.predicted_wrench import PredictedWrench
from testbed.sensors.sensor_error import SensorError, Signal

STEP = 1e-3
"""Of a coefficient, for differences."""

INSTANT = 1e-3
"""Of time, for differences along a motion [s]."""

MOST_ITERATIONS, CONVERGED = 60, 1e-13
"""Of the correction of a signal; its last change, relative to the signal."""


class Coefficient(NamedTuple):
    """Unknown number of a systematic error.

    Attributes:
        name: Such as "pose/rx".
        unit: Its unit.
        neutral: Its value of a sensor without the error.
    """

    name: str
    unit: str
    neutral: float = 0.0


class SystematicError(SensorError):
    """Sensor error that is a function of signal, time and a few coefficients."""

    fixed: ClassVar[tuple[Coefficient, ...]] = ()
    """Coefficients, where they are the same on every robot."""
    term: ClassVar[str]
    """Name among the unknowns of an estimate, before the slash of coefficients' names; default the
    kind."""
    remedy: ClassVar[str] = ""
    """What a person should do about it; default to estimate it."""
    estimated: ClassVar[bool] = True
    """Whether an estimate may have the coefficients among its unknowns; else they are tested."""
    estimated_as: ClassVar[str] = ""
    """Term that is estimated in place of this one; default its own."""
    tested: ClassVar[bool] = True
    """Whether every estimate tests its residuals for the error, and names it as a likely cause."""
    of_one_recording: ClassVar[bool] = False
    """Whether the coefficients of another recording are others."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Terms of simpler errors whose effects are among those of this one."""
    jointly: ClassVar[bool] = False
    """Whether the coefficients are of use only if all of them are identifiable."""
    added: ClassVar[bool] = False
    """Whether the effect is added to the channels as they are, before any mixture of them is taken
    back."""
    unfolded: ClassVar[bool] = False
    """Whether the columns need so many instants that the encoders' noise is not folded. A constant
    error does; others would have too much in common with that noise in the rows."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "kind" in cls.__dict__ and "term" not in cls.__dict__:
            cls.term = cls.kind

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Coefficients on a robot, k in all.

        Args:
            tree: The robot: names and kinds of its joints, cuts at force sensors.
        """
        del tree
        return cls.fixed

    @property
    def values(self) -> Array:
        """Values of the coefficients, (k,), or one for all: by default the keys, in their order."""
        values = []
        for name, key in self.known_keys().items():
            value = np.atleast_1d(np.asarray(getattr(self, name), dtype=float))
            values.append(np.broadcast_to(value, COUNTS.get(key.members, len(value))))
        return np.concatenate(values)

    @classmethod
    @abstractmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Signal with the error.

        Args:
            signal: (M, c).
            time: From the first sample on, or from the middle, (M,) [s].
            values: Of the coefficients, (k,).
        """

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Signal with the error, (M, c)."""
        del rng
        return self.effect(signal, time, self.values)

    @classmethod
    def neutral(cls, tree: Tree) -> Array:
        """Values of the coefficients without the error, (k,)."""
        return np.array([each.neutral for each in cls.coefficients(tree)])

    @classmethod
    def derivative(cls, signal: Array, time: Array, neutral: Array) -> Array:
        """Derivative of `effect` by the coefficients, (M, c, k); default by central differences.

        Args:
            signal: (M, c).
            time: (M,) [s].
            neutral: Values of the coefficients without the error, (k,).
        """
        columns = [
            cls.effect(signal, time, neutral + step)
            - cls.effect(signal, time, neutral - step)
            for step in STEP * np.eye(len(neutral))
        ]
        return np.stack(columns, axis=-1) / (2 * STEP)

    @classmethod
    def without(cls, signal: Array, time: Array, values: Array) -> Array:
        """Signal without the error, (M, c): inverse of `effect`; default by iteration.

        Args:
            signal: With the error, (M, c).
            time: (M,) [s].
            values: Of the coefficients, (k,).
        """
        estimate, size = signal, np.abs(signal).max(initial=0.0)
        for _ in range(MOST_ITERATIONS):
            change = signal - cls.effect(estimate, time, values)
            estimate = estimate + change
            if np.abs(change).max(initial=0.0) <= CONVERGED * size:
                break
        return estimate

    @classmethod
    def undo(
        cls, recording: Recording, values: Array, time: Array, tree: Tree
    ) -> Recording:
        """Recording as it would be without the error.

        Args:
            recording: With the error.
            values: Of the coefficients, (k,).
            time: Of the samples, from the middle of the whole recording, (M,) [s].
            tree: The robot.
        """
        del tree
        changed: Any = {
            cls.signal: cls.without(recording.measured(cls.signal), time, values)
        }
        return replace(recording, **changed)

    @classmethod
    def samples_lost(cls, values: Array, rate: float) -> int:
        """Samples at either end of a recording that cannot be corrected.

        Args:
            values: Of the coefficients, (k,).
            rate: Samples a second [Hz].
        """
        del values, rate
        return 0

    @classmethod
    @abstractmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the measured wrench by the coefficients at the rows, (rows, 6, k).

        Args:
            predicted: By an estimate.
        """

    @classmethod
    def measured_columns(cls, predicted: PredictedWrench) -> Array:
        """Columns made of the measured wrench where that is possible, (rows, 6, k).

        Noise of the encoders is in the predicted wrench and in the residual, and makes weakly
        identifiable coefficients drift; noise of the plate is in neither twice.

        Args:
            predicted: With the measured wrench.
        """
        return cls.columns(predicted)

    @classmethod
    def unmixing(cls, values: Array) -> Array | None:
        """Inverse of the mixture of the plate's channels, (6, 6); None for no mixture.

        Args:
            values: Of the coefficients, (k,).
        """
        del values
        return None


class PlateError(SystematicError):
    """Systematic error of a plate's wrench, slow beside the filter on rows."""

    signal: ClassVar[Signal] = "wrench"

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative by the coefficients of the predicted wrench, (rows, 6, k)."""
        neutral = cls.neutral(predicted.tree)
        return cls.derivative(predicted.wrench, predicted.time, neutral)

    @classmethod
    def measured_columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative by the coefficients of the measured wrench, (rows, 6, k)."""
        return cls.derivative(
            predicted.shown, predicted.time, cls.neutral(predicted.tree)
        )


class EncoderError(SystematicError):
    """Systematic error of joint positions, of each joint by coefficients of its own."""

    signal: ClassVar[Signal] = "position"
    per_joint: ClassVar[tuple[str, ...]] = ("",)
    """Ends of the names of a joint's coefficients."""
    units: ClassVar[tuple[str, str]]
    """Units of a coefficient at a revolute and at a prismatic joint."""
    of_revolute: ClassVar[bool] = False
    """Whether prismatic joints have none."""

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Coefficients of the joints, joint by joint."""
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
        """Derivatives of a joint's position, velocity and acceleration by its coefficients.

        Default by differences of `effect` along the motion.

        Args:
            q: Position, (m,) [rad or m].
            qd: Velocity, (m,).
            qdd: Acceleration, (m,).
        """
        around = []
        for h in (-INSTANT, 0.0, INSTANT):
            signal = (q + h * qd + h**2 / 2 * qdd)[:, None]
            none = np.zeros(len(cls.per_joint))
            around.append(cls.derivative(signal, np.full(len(q), h), none)[:, 0].T)
        before, here, after = around
        rate = (after - before) / (2 * INSTANT)
        return zip(here, rate, (after - 2 * here + before) / INSTANT**2, strict=True)

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the wrench by the coefficients, (rows, 6, k).

        The residual is the measured wrench less the one predicted at the measured positions.
        """
        motion = predicted.motion
        signals = [np.zeros((motion.samples, 6, 0))]
        for j, joint in enumerate(predicted.tree.joints):
            if joint.revolute or not cls.of_revolute:
                own = (each[:, j] for each in (motion.q, motion.qd, motion.qdd))
                errors = cls.coordinate_errors(*own)
                signals += [-predicted.along(j, *each)[..., None] for each in errors]
        return predicted.rows(np.concatenate(signals, axis=2))


class ClockError(SystematicError):
    """Systematic error of the instants at which the plate is sampled."""

    signal: ClassVar[Signal] = "wrench"

    @classmethod
    @abstractmethod
    def lateness(cls, time: Array) -> Array | float:
        """Derivative of the plate's delay by the coefficient, (M,) or one [s]."""

    @classmethod
    def columns(cls, predicted: PredictedWrench) -> Array:
        """Derivative of the wrench in time, less a delay, (rows, 6, 1)."""
        late = np.broadcast_to(cls.lateness(predicted.time), len(predicted.time))
        return np.asarray(
            -predicted.rates(predicted.moving[..., None]) * late[:, None, None]
        )


def of_channels(
    prefix: str, units: Sequence[str] = PLATE_UNITS
) -> tuple[Coefficient, ...]:
    """Coefficients of the plate's six channels.

    Args:
        prefix: Of their names.
        units: One each.
    """
    names = (f"{prefix}/{axis}" for axis in AXES)
    return tuple(map(Coefficient, names, units))
