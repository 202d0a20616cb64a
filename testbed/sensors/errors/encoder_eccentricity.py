"""Eccentricity of encoders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt

from testbed.core.base.arrays import Array
from testbed.sensors.kind_table import RANDOM_PHASE, PerJoint, joint_array
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import EncoderError


@dataclass(frozen=True)
class EncoderEccentricity(EncoderError):
    """Eccentric encoder discs: a position error that is periodic in the position.

    The reading is q + amplitude sin(2 pi q / period + phase). At a prismatic joint the period is
    the travel per turn of the screw or belt pulley.

    Source    10 um at a radius of 25 mm, the mounting tolerance in data sheets of ring encoders.

    Attributes:
        amplitude: Amplitude of the error [rad or m].
        period: Period of the error in the joint position [rad or m].
        phase: Phase of the error at q = 0; drawn at random if omitted [rad].
    """

    kind: ClassVar[str] = "encoder_eccentricity"
    remedy: ClassVar[str] = "correct the encoders once a turn"
    term: ClassVar[str] = "eccentricity"
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    estimated: ClassVar[bool] = False
    of_revolute: ClassVar[bool] = True
    per_joint: ClassVar[tuple[str, ...]] = ("/sin", "/cos")
    units: ClassVar[tuple[str, str]] = ("rad", "rad")
    amplitude: PerJoint = 4e-4
    period: Annotated[PerJoint, Gt(0)] = 2 * np.pi
    phase: Annotated[PerJoint | None, RANDOM_PHASE] = None

    @property
    def values(self) -> Array:
        """Amplitudes of sine and cosine, joint by joint, for a period of one turn."""
        size, phase = np.broadcast_arrays(
            joint_array(self.amplitude), joint_array(self.phase or 0.0)
        )
        return np.stack([size * np.cos(phase), size * np.sin(phase)], axis=-1).ravel()

    @classmethod
    def effect(cls, signal: Array, time: Array, values: Array) -> Array:
        """Positions with sine and cosine of one turn added, (M, n) [rad]."""
        del time
        sine, cosine = values.reshape(-1, 2).T
        return signal + sine * np.sin(signal) + cosine * np.cos(signal)

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """Positions with a sine of any period added, (M, n) [rad or m]."""
        del time, rng
        angle = 2 * np.pi * signal / joint_array(self.period) + joint_array(
            self.phase or 0.0
        )
        return signal + joint_array(self.amplitude) * np.sin(angle)
