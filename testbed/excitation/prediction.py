"""The sigma that a motion promises, before any run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.codec import with_properties
from testbed.excitation.fourier import Fourier
from testbed.excitation.information import Information
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.samples import Samples
from testbed.parameters.rules import Model

DENSITY = 24
"""Samples of a period for each harmonic: those of the rows are at most four times the motion's."""


@dataclass(frozen=True, eq=False)
class Pipeline:
    """What an estimate makes of a recording.

    Attributes:
        rate: Samples a second [Hz].
        span: Time that its filters leave of the recording [s].
        band: What is faster in the rows does not count [Hz]; infinite for all.
        resting: Rows of a joint do not count while it is slower, nor near it [rad/s or m/s].
        reach: So near [s].
    """

    rate: float
    span: float
    band: float
    resting: float
    reach: float


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a motion promises.

    Attributes:
        names: Of the minimal parameters.
        sigma: Of each, (N,) [kg, kg m, kg m^2].
        relative: The same as shares of the values, small ones counted as larger, (N,).
        condition: Condition number of the rows on relative parameters.
    """

    names: tuple[str, ...]
    sigma: Array
    relative: Array
    condition: float

    __get_pydantic_core_schema__ = with_properties("rms")

    @property
    def rms(self) -> float:
        """Of the relative sigmas."""
        return float(np.sqrt(np.mean(self.relative**2)))


def predict(
    information: Information,
    rows: Mapping[Model, SampledRows],
    motion: Fourier,
    pipeline: Pipeline,
    names: tuple[str, ...],
) -> Prediction:
    """The sigma of white noise alone.

    Args:
        information: What is asked; its prior is a share of one sample.
        rows: Of the models that it looks at.
        motion: The motion, repeated.
        pipeline: What an estimate makes of it.
        names: Of the minimal parameters.
    """
    count = max(DENSITY * motion.harmonics, 200)
    times = np.arange(count) * motion.period / count
    at = motion.at(times)
    samples = Samples(at.q, at.qd, at.qdd, rows, None)
    counted = moving(motion, count, pipeline)
    keep = int(pipeline.band * motion.period) if np.isfinite(pipeline.band) else count
    matrix = information.matrix(samples, counted=counted, harmonics=keep)
    matrix = (matrix / count + information.prior) * pipeline.rate * pipeline.span
    covariance = information.covariance(matrix)
    if covariance is None:
        relative = np.full(information.counted, np.inf)
        return Prediction(names, relative * information.scale, relative, np.inf)
    relative = np.sqrt(np.diag(covariance))
    spread = np.linalg.eigvalsh(covariance)
    condition = float(np.sqrt(spread[-1] / spread[0]))
    return Prediction(names, relative * information.scale, relative, condition)


def moving(motion: Fourier, count: int, pipeline: Pipeline) -> NDArray[np.bool_]:
    """Whether each joint's rows count at samples of a period, (count, n)."""
    times = np.arange(count) * motion.period / count
    found = np.abs(motion.derivative(times, 1)) > pipeline.resting
    near = round(pipeline.reach * count / motion.period)
    return np.asarray(
        np.all([np.roll(found, shift, axis=0) for shift in range(-near, near + 1)], axis=0)
    )
