"""Calibrate the plate by the robot's own motion: its 36 sensitivities, zero and delay.

The laws of rigid bodies tie all channels to the same few parameters, so that a robot that moves
is a load of known form. What they leave open, a scale above all, has to be known: a mass, a gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.codec import with_properties
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.identify import identify
from testbed.core.estimation.regression.normal_equations import (
    square_root,
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

UNKNOWN = ("matrix", "bias", "skew")
"""What is calibrated unless something else is asked for."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The plate as a robot's motion identifies it.

    Attributes:
        robot: The robot's name.
        known: Value and sigma of what was known before, by name.
        numbers: Of the plate, with their sigmas.
        estimate: Of the robot, made with them; None where it is not known any more.
        correlation: Of the numbers, (k, k); None where they are taken as independent.
    """

    robot: str
    known: Mapping[str, tuple[float, float]]
    numbers: tuple[NuisanceEstimate, ...]
    estimate: Estimate | None = None
    correlation: Array | None = None

    __get_pydantic_core_schema__ = with_properties("matrix", "matrix_sigma")

    @property
    def doubt(self) -> CalibrationCovariance:
        """What is left open of the numbers that hold for other recordings, too."""
        passing = {error.term for error in estimable_errors() if error.of_one_recording}
        kept = [k for k, each in enumerate(self.numbers) if each.kind not in passing]
        correlation = (
            np.eye(len(self.numbers)) if self.correlation is None else self.correlation
        )
        sigma = np.array([self.numbers[k].sigma for k in kept])
        root = sigma[:, None] * square_root(correlation[np.ix_(kept, kept)])
        return CalibrationCovariance(tuple(self.numbers[k].name for k in kept), root)

    @property
    def matrix(self) -> Array:
        """What the plate shows of a wrench, (6, 6): shown = matrix @ wrench + bias."""
        values = {each.name: each.value for each in self.numbers}
        flat = [values.get(name, right) for name, _, right in SENSITIVITIES]
        return np.array(flat).reshape(6, 6)

    @property
    def matrix_sigma(self) -> Array:
        """Standard deviations of its elements, (6, 6)."""
        sigma = {each.name: each.sigma for each in self.numbers}
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
    progress: Progress = unreported,
) -> Calibration:
    """Numbers of the plate and parameters of the robot at once, from one recording.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: As for `identify`; it needs the wrench.
        known: A value, or value and sigma, by name: "mass" [kg], "gain/Fz", a minimal parameter.
        gravity: (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: How the signals are treated; their nuisances, if any, in place of `UNKNOWN`.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording cannot be used.
        SettingsError: What is known does not suffice; says what is left open.
    """
    settings = replace(
        settings,
        nuisances=settings.nuisances or UNKNOWN,
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
    """Of the instrument's numbers, (k, k): one with itself, even where it is known."""
    found, _ = unit_diagonal(estimate.nuisance_covariance)
    np.fill_diagonal(found, 1.0)
    return found


def corrected(source: Source, tree: Tree, plate: Calibration) -> Source:
    """A recording as a perfect plate would have made it; its zero is its own and stays.

    Args:
        source: The recording.
        tree: The robot.
        plate: The plate that it was made with.
    """
    return without_errors(
        source, tree, {each.name: each.value for each in plate.numbers}
    )
