"""The information matrix of the unknowns: criteria, derivatives by the motion, predicted sigma."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.codec import with_properties
from testbed.core.parameters.minimal_set import selection
from testbed.core.parameters.rules import Model
from testbed.core.parameters.symbols import parameter_scale
from testbed.motion.fourier import Fourier
from testbed.motion.samples import SMALL, SampledRows, Samples

Criterion: TypeAlias = Callable[[Array], tuple[float, Array]]
"""Of C, (N, N): the value, and its derivative by C, (N, N)."""

CriterionName = Literal["a", "d", "e"]


POWER = 8
"""Of the norm that stands for the largest eigenvalue."""


def a_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of the mean variance, and its derivative."""
    count, trace = len(covariance), float(np.trace(covariance))
    return float(np.log(trace / count)), np.eye(count) / trace


def d_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of the geometric mean of the variances along the axes, and its derivative."""
    count = len(covariance)
    size = float(np.linalg.slogdet(covariance)[1])
    return size / count, np.linalg.inv(covariance) / count


def e_optimal(covariance: Array) -> tuple[float, Array]:
    """Log of a smooth stand-in for the largest variance along an axis, and its derivative."""
    values, axes = eigh(covariance)
    share = np.maximum(values, 0.0) / values[-1]
    total = float(np.sum(share**POWER))
    value = float(np.log(values[-1]) + np.log(total / len(values)) / POWER)
    return value, (axes * (share ** (POWER - 1) / (total * values[-1]))) @ axes.T


CRITERIA: dict[CriterionName, Criterion] = {
    "a": a_optimal,
    "d": d_optimal,
    "e": e_optimal,
}
"""By name."""


Instrument = Literal["plate", "joints", "both"]
"""Whose rows count: the bedplate's wrench, the joints' torques, or all."""


SMOOTH = 0.05
"""Speed over which the sign of dry friction is smoothed, for derivatives [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class RegressorRows:
    """Regressor rows of one model, expressed in the unknowns.

    Attributes:
        model: Whose rows.
        slots: Of each channel.
        lead: What a channel's slots have of the unknowns, (s, U) each.
        weights: One over the variance of each channel's noise, (channels,).
        friction: Place of the joints' dry friction among the unknowns, viscous friction after it;
            None for the plate, which feels none.
    """

    model: Model
    slots: tuple[slice, ...]
    lead: tuple[Array, ...]
    weights: Array
    friction: int | None

    def rows(self, samples: Samples) -> list[Array]:
        """The rows of each channel on all unknowns, (G, U) each."""
        slots, speeds = samples.slots[self.model][:, 0], samples.motion.qd
        found = [
            slots[own].T @ lead for own, lead in zip(self.slots, self.lead, strict=True)
        ]
        if self.friction is not None:
            n = len(found)
            for joint, phi in enumerate(found):
                qd, first = speeds[:, joint], self.friction + joint
                phi[:, first], phi[:, first + n] = np.tanh(qd / SMOOTH), qd
        return found


@dataclass(frozen=True, eq=False)
class DesignObjective:
    """Objective of a design: the parameters to identify, and the rows that identify them.

    Attributes:
        names: Names of the minimal parameters, the first of the unknowns; friction is a nuisance.
        scale: What their relative errors are relative to, (N,).
        parts: Rows that identify them.
        prior: Information that is there before, on all unknowns, (U, U), as much as of one
            measurement an instant.
        criterion: By name.
    """

    names: tuple[str, ...]
    scale: Array
    parts: tuple[RegressorRows, ...]
    prior: Array
    criterion: CriterionName = "a"

    def matrix(
        self,
        samples: Samples,
        counted: NDArray[np.bool_] | None = None,
        harmonics: int | None = None,
    ) -> Array:
        """The information of one measurement an instant, the prior aside, (U, U).

        Args:
            samples: The instants; of one period, if `harmonics` is given.
            counted: Whether each joint's row counts at each instant, (G, n); default all.
            harmonics: Of the plate's rows, those that count; default all.
        """
        total = np.zeros_like(self.prior)
        for part in self.parts:
            for channel, phi in enumerate(part.rows(samples)):
                if part.friction is not None and counted is not None:
                    phi = counted[:, [channel]] * phi
                elif part.friction is None and harmonics is not None:
                    waves = np.fft.rfft(phi, axis=0)
                    waves[harmonics + 1 :] = 0
                    phi = np.fft.irfft(waves, len(phi), axis=0)
                total += part.weights[channel] * (phi.T @ phi)
        return total

    def value(self, samples: Samples) -> float:
        """The criterion; infinite where an unknown is not seen."""
        covariance = self.covariance(self.matrix(samples) + self.prior)
        return np.inf if covariance is None else CRITERIA[self.criterion](covariance)[0]

    def slopes(self, samples: Samples) -> Array:
        """The criterion's derivatives by q, then qd, then qdd of every instant, (3 n, G)."""
        full = _inverse(self.matrix(samples) + self.prior)
        assert full is not None
        assert samples.stencil is not None
        count = len(self.scale)
        by_covariance = CRITERIA[self.criterion](full[:count, :count])[1]
        by_matrix = full[:, :count] @ by_covariance @ full[:count]  # times -1
        n = samples.motion.q.shape[1]
        total = np.zeros((3 * n, samples.motion.samples))
        for part in self.parts:
            slots = samples.slots[part.model]
            pulled = np.zeros(slots.shape[::2])
            for c, phi in enumerate(part.rows(samples)):
                back = -2 * part.weights[c] * (by_matrix @ phi.T)  # (U, G)
                pulled[part.slots[c]] += part.lead[c] @ back
                if part.friction is not None:
                    dry, wet = back[part.friction + c], back[part.friction + n + c]
                    sign = np.tanh(samples.motion.qd[:, c] / SMOOTH)
                    total[n + c] += dry * (1 - sign**2) / SMOOTH
                    total[n + c] += wet
            total += samples.stencil.weights @ np.einsum("sg,seg->eg", pulled, slots)
        return total

    def covariance(self, information: Array) -> Array | None:
        """Covariance of the minimal parameters' relative errors; None if one is not seen."""
        full = _inverse(information)
        count = len(self.scale)
        return None if full is None else full[:count, :count]


def information_of(
    rows: Mapping[Model, SampledRows],
    instrument: Instrument,
    plate_noise: Array,
    torque_noise: Array,
    criterion: CriterionName = "a",
    prior: Array | None = None,
) -> DesignObjective:
    """Collect what a motion should identify.

    Args:
        rows: Of the models that `models_of(instrument)` names.
        instrument: Whose rows count.
        plate_noise: Standard deviation of the plate's channels, (6,) [N, N m].
        torque_noise: Of the joints' torques, (n,) [N m or N].
        criterion: By name.
        prior: Covariance of the minimal parameters from before, (N, N); None for none.
    """
    main = rows["dynamic" if instrument == "joints" else "reaction"]
    scale = parameter_scale(main.delta, main.minimal.units, SMALL)
    count = len(scale)
    unknowns = count if instrument == "plate" else count + 2 * len(torque_noise)
    parts = []
    for model in models_of(instrument):
        here, joints = rows[model], model == "dynamic"
        same = here.minimal is main.minimal
        lead = np.zeros((here.minimal.count, unknowns))
        lead[:, :count] = scale * (
            np.eye(count) if same else selection(here.minimal, main.minimal)
        )
        slots, bases = zip(*here.channels(), strict=True)
        leads = tuple(basis @ lead for basis in bases)
        weights = (torque_noise if joints else plate_noise) ** -2.0
        parts.append(
            RegressorRows(model, slots, leads, weights, count if joints else None)
        )
    before = np.zeros((unknowns, unknowns))
    if prior is not None:
        before[:count, :count] = np.linalg.inv(prior) * np.outer(scale, scale)
    return DesignObjective(main.minimal.names, scale, tuple(parts), before, criterion)


def models_of(instrument: Instrument) -> tuple[Model, ...]:
    """Whose rows an instrument gives."""
    if instrument == "both":
        return "reaction", "dynamic"
    return ("reaction" if instrument == "plate" else "dynamic",)


def _inverse(matrix: Array) -> Array | None:
    """Of a positive definite matrix whose diagonal may span many orders; None of another."""
    size = np.sqrt(np.diag(matrix))
    if not (np.isfinite(matrix).all() and (size > 0).all()):
        return None
    try:
        half = np.linalg.inv(np.linalg.cholesky(matrix / np.outer(size, size)))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(half.T @ half / np.outer(size, size))


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

    @property
    def samples(self) -> float:
        """Number of samples that the filters leave."""
        return self.rate * self.span


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
    information: DesignObjective,
    rows: Mapping[Model, SampledRows],
    motion: Fourier,
    pipeline: Pipeline,
) -> Prediction:
    """Predict standard deviations, those of white noise alone.

    Args:
        information: What is asked; its prior is a share of one sample.
        rows: Of the models that it looks at.
        motion: The motion, repeated.
        pipeline: What an estimate makes of it.
    """
    count = max(DENSITY * motion.harmonics, 200)
    samples = Samples(motion.at(motion.instants(count)), rows, None)
    counted = moving(motion, count, pipeline)
    keep = int(pipeline.band * motion.period) if np.isfinite(pipeline.band) else count
    matrix = information.matrix(samples, counted=counted, harmonics=keep)
    matrix = (matrix / count + information.prior) * pipeline.samples
    covariance = information.covariance(matrix)
    if covariance is None:
        relative, condition = np.full(len(information.scale), np.inf), np.inf
    else:
        relative = np.sqrt(np.diag(covariance))
        condition = float(np.sqrt(np.linalg.cond(covariance)))
    return Prediction(
        information.names, relative * information.scale, relative, condition
    )


def moving(motion: Fourier, count: int, pipeline: Pipeline) -> NDArray[np.bool_]:
    """Whether each joint's rows count at samples of a period, (count, n)."""
    fast = np.abs(motion.derivative(motion.instants(count), 1)) > pipeline.resting
    width = 2 * round(pipeline.reach * count / motion.period) + 1
    return np.asarray(minimum_filter1d(fast, width, axis=0, mode="wrap"))
