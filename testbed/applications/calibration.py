"""Calibration of the force plate by a robot's motion: sensitivities, zero offsets and delay.

The equations of motion express all channels by the same few inertial parameters, so that a moving
robot is a load of known form. Quantities that these equations leave undetermined, a scale above
all, have to be known: a mass, or the gain of a channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.identify import identify
from testbed.core.estimation.regression.normal_equations import (
    matrix_square_root,
    unit_diagonal,
)
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.source import RecordingLike, Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors
from testbed.sensors.corrected import corrected as without_errors
from testbed.sensors.errors.plate_matrix import SENSITIVITIES

DEFAULT_NUISANCES = ("matrix", "bias", "skew")
"""Sensor errors that are estimated if the settings name none."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Sensor errors of the force plate, estimated from a robot's motion.

    Attributes:
        robot: The robot's name.
        known: Values and standard deviations of the quantities known beforehand, by name.
        numbers: Estimated coefficients of the plate's sensor errors, with standard deviations.
        estimate: Estimate of the robot's parameters from the same fit; None if not available.
        correlation: Correlation matrix of the k coefficients, (k, k); None if they are treated as
            independent.
    """

    robot: str
    known: Mapping[str, tuple[float, float]]
    numbers: tuple[NuisanceEstimate, ...]
    estimate: Estimate | None = None
    correlation: Array | None = None

    __get_pydantic_core_schema__ = schema_with_properties("matrix", "matrix_sigma")

    @property
    def doubt(self) -> CalibrationCovariance:
        """Covariance of the coefficients that also apply to other recordings, as a square root.

        Coefficients that hold for a single recording only, such as the zero offset, are omitted.
        Without a correlation matrix, the coefficients are treated as independent.
        """
        recording_terms = {
            error.term for error in estimable_errors() if error.of_one_recording
        }
        indices = [
            k
            for k, coefficient in enumerate(self.numbers)
            if coefficient.kind not in recording_terms
        ]
        correlation = (
            np.eye(len(self.numbers)) if self.correlation is None else self.correlation
        )
        sigma = np.array([self.numbers[k].sigma for k in indices])
        root = sigma[:, None] * matrix_square_root(
            correlation[np.ix_(indices, indices)]
        )
        return CalibrationCovariance(tuple(self.numbers[k].name for k in indices), root)

    @property
    def matrix(self) -> Array:
        """Sensitivity matrix of the plate, (6, 6), with `reading = matrix @ wrench + bias`.

        Elements that were not estimated have the values of the identity matrix.
        """
        values = {coefficient.name: coefficient.value for coefficient in self.numbers}
        elements = [values.get(name, nominal) for name, _, nominal in SENSITIVITIES]
        return np.array(elements).reshape(6, 6)

    @property
    def matrix_sigma(self) -> Array:
        """Standard deviations of the sensitivity matrix, (6, 6); 0 where not estimated."""
        sigma = {coefficient.name: coefficient.sigma for coefficient in self.numbers}
        return np.array([sigma.get(name, 0.0) for name, _, _ in SENSITIVITIES]).reshape(
            6, 6
        )


def calibrate(
    tree: Tree,
    recording: RecordingLike,
    known: Mapping[str, float | Sequence[float]],
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> Calibration:
    """Estimate the plate's sensor errors and the robot's parameters from one recording.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: Recording with the wrench, as for `identify`.
        known: Value, or value and standard deviation, of each known quantity by name: "mass" [kg],
            "gain/Fz", or a base parameter.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: Signal processing; its sensor-error terms (nuisances), if any, replace
            `DEFAULT_NUISANCES`.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples.

    Raises:
        RecordingError: The recording cannot be used.
        SettingsError: The known quantities do not suffice; the message lists what remains
            undetermined.
    """
    settings = replace(
        settings,
        nuisances=settings.nuisances or DEFAULT_NUISANCES,
        known={**settings.known, **known},
    )
    estimate = identify(
        tree,
        recording,
        gravity=gravity,
        settings=settings,
        threads=threads,
        progress=progress,
    )
    return Calibration(
        tree.name, settings.facts, estimate.nuisances, estimate, _correlation(estimate)
    )


def _correlation(estimate: Estimate) -> Array:
    """Correlation matrix of the k estimated sensor-error coefficients, (k, k).

    Diagonal elements are 1, also for coefficients that are known exactly.
    """
    correlation, _ = unit_diagonal(estimate.nuisance_covariance)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def corrected(source: Source, tree: Tree, plate: Calibration) -> Source:
    """Recording with the plate's calibrated errors removed from the wrench.

    Zero offset and drift apply to a single recording only and are not removed.

    Args:
        source: The recording.
        tree: The robot.
        plate: Calibration of the plate with which the recording was made.
    """
    return without_errors(
        source,
        tree,
        {coefficient.name: coefficient.value for coefficient in plate.numbers},
    )
