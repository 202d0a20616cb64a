"""The information matrix of the unknowns: criteria, derivatives by the motion, predicted sigma."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.base.codec import with_properties
from testbed.core.parameters.minimal_set import selection
from testbed.core.parameters.rules import Model
from testbed.core.robot.friction import COULOMB, VISCOUS, JointLaw
from testbed.core.robot.tree import Tree
from testbed.motion.fourier import Fourier
from testbed.motion.joint_unknowns import JointUnknowns, scale_of
from testbed.motion.samples import SampledRows, Samples

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


CRITERIA: dict[CriterionName, Criterion] = {"a": a_optimal, "d": d_optimal, "e": e_optimal}
"""By name."""


Instrument = Literal["plate", "joints", "both"]
"""Whose rows count: the bedplate's wrench, the joints' torques, or all."""


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one model in terms of the unknowns.

    Attributes:
        model: Whose rows.
        slots: Of each channel.
        lead: What a channel's slots have of the unknowns, (s, U) each.
        weights: One over the variance of each channel's noise, (channels,).
        load: What a channel's slots are worth by the a-priori model, (s,) each.
        own: Unknowns of the joints' own torque; None for the plate.
    """

    model: Model
    slots: tuple[slice, ...]
    lead: tuple[Array, ...]
    weights: Array
    load: tuple[Array, ...]
    own: JointUnknowns | None


@dataclass(frozen=True, eq=False)
class Information:
    """What is asked of a motion.

    Attributes:
        names: Names of the unknowns that count.
        counted: Those of the unknowns that count; the others are nuisances.
        scale: What their relative errors are relative to, (counted,).
        parts: Rows that identify them.
        prior: Information that is there before, on all unknowns, (U, U), as much as of one
            measurement an instant.
        criterion: By name.
        reversal: Speed below which rows of a joint do not count, and time from such a speed
            [rad/s or m/s, s]; in a search they count the less, the nearer.
    """

    names: tuple[str, ...]
    counted: slice
    scale: Array
    parts: tuple[Part, ...]
    prior: Array
    criterion: CriterionName = "a"
    reversal: tuple[float, float] = (0.0, 0.0)

    @property
    def of_friction(self) -> bool:
        """Whether joint friction and torque constants count, the bodies being nuisances."""
        return self.counted.start is not None

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
            harmonics: Of the rows, those that count; default all.
        """
        unknowns = len(self.prior)
        total = np.zeros((unknowns, unknowns))
        for part in self.parts:
            for channel, phi in enumerate(self._columns(part, samples)):
                if part.own is not None:
                    far = self._far(samples, channel)[0] if counted is None else counted[:, channel]
                    phi *= np.sqrt(far)[:, None]
                elif harmonics is not None and 2 * harmonics < len(phi):
                    waves = np.fft.rfft(phi, axis=0)
                    waves[harmonics + 1 :] = 0
                    phi[:] = np.fft.irfft(waves, len(phi), axis=0)
                total += part.weights[channel] * (phi.T @ phi)
        return total

    def value(self, samples: Samples) -> float:
        """The criterion; infinite where an unknown is not seen."""
        covariance = self._covariance(samples)
        return np.inf if covariance is None else self._judged(covariance)[0]

    def slopes(self, samples: Samples) -> Array:
        """The criterion's derivatives by q, then qd, then qdd of every instant, (3 n, G)."""
        covariance = self._covariance(samples)
        assert covariance is not None
        assert samples.stencil is not None
        seen = covariance[:, self.counted]
        by_matrix = seen @ self._judged(covariance)[1] @ seen.T  # times -1
        n = samples.q.shape[1]
        total = np.zeros((3 * n, len(samples.q)))
        for part in self.parts:
            slots = samples.slots[part.model]
            pulled = np.zeros((len(slots), len(samples.q)))
            for c, phi in enumerate(self._columns(part, samples)):
                back = -2 * part.weights[c] * (by_matrix @ phi.T)  # (U, G)
                if part.own is not None:
                    far, *far_slopes = self._far(samples, c)
                    all_of_it = np.sum(back * phi.T, axis=0) / 2
                    back *= far
                    *by_motion, by_load = part.own.slopes(c, back, *_of_joint(samples, part, c))
                    for order, slope in enumerate(by_motion):
                        total[(1 + order) * n + c] += slope + all_of_it * far_slopes[order]
                    pulled[part.slots[c]] += np.outer(part.load[c], by_load)
                pulled[part.slots[c]] += part.lead[c] @ back
            total += samples.stencil.weights @ np.einsum("sg,seg->eg", pulled, slots)
        return total

    def covariance(self, information: Array) -> Array | None:
        """Of the counted unknowns, as relative errors; None if one is not seen."""
        full = _inverse(information)
        return None if full is None else full[self.counted, self.counted]

    def _covariance(self, samples: Samples) -> Array | None:
        return _inverse(self.matrix(samples) + self.prior)

    def _far(self, samples: Samples, joint: int) -> tuple[Array, Array, Array]:
        """How much a joint's rows count, far from a reversal all; derivatives by qd and qdd."""
        (slow, reach), qd, qdd = self.reversal, samples.qd[:, joint], samples.qdd[:, joint]
        square = np.maximum(slow**2 + (reach * qdd) ** 2, np.finfo(float).tiny)
        whole = qd**2 + square  # it was at rest abs(qd / qdd) ago, or will be
        by_qd, by_qdd = 2 * qd * square / whole**2, -2 * reach**2 * qdd * qd**2 / whole**2
        return qd**2 / whole, by_qd, by_qdd

    def _judged(self, covariance: Array) -> tuple[float, Array]:
        return CRITERIA[self.criterion](covariance[self.counted, self.counted])

    def _columns(self, part: Part, samples: Samples) -> list[Array]:
        """The rows of each channel on all unknowns, (G, U) each."""
        slots = samples.slots[part.model][:, 0]
        found = [slots[own].T @ lead for own, lead in zip(part.slots, part.lead, strict=True)]
        if part.own is not None:
            for c, phi in enumerate(found):
                part.own.add(phi, c, *_of_joint(samples, part, c))
        return found


def _of_joint(samples: Samples, part: Part, joint: int) -> tuple[Array, Array, Array]:
    """Velocity, acceleration and load, (G,) each."""
    return samples.qd[:, joint], samples.qdd[:, joint], samples.forces(part.model)[joint]


def information_of(
    tree: Tree,
    rows: dict[Model, SampledRows],
    instrument: Instrument,
    plate_noise: Array,
    torque_noise: Array,
    criterion: CriterionName = "a",
    prior: Array | None = None,
    friction: Sequence[JointLaw] = (),
    reversal: tuple[float, float] = (0.0, 0.0),
) -> Information:
    """What is asked of a motion.

    Args:
        tree: The robot.
        rows: Of the models that `models_of(instrument)` names.
        instrument: Whose rows count.
        plate_noise: Standard deviation of the plate's channels, (6,) [N, N m].
        torque_noise: Of the joints' torques, (n,) [N m or N].
        criterion: By name.
        prior: Covariance of the minimal parameters from before, (N, N); None for none.
        friction: Laws whose coefficients are to be identified, with the torque constants, the
            bodies being nuisances; () for the bodies, dry and viscous friction being nuisances.
        reversal: As `Information.reversal`.
    """
    main = rows["dynamic" if instrument == "joints" else "reaction"]
    bodies = scale_of(main.delta, main.minimal.units)
    count = len(bodies)
    names = main.minimal.names
    if friction:
        kinds = ("constant", *(law.kind for law in friction))
        names = tuple(f"{kind}/{joint}" for kind in kinds for joint in tree.names)
        own = JointUnknowns.relative(tree, tuple(friction), count)
        counted = slice(count, own.first + own.scale.size)
        scale = np.concatenate([np.ones(tree.n), own.scale.ravel()])
    else:
        ones = np.ones((2, tree.n))
        own = JointUnknowns((COULOMB, VISCOUS), count, ones, 0 * ones)
        counted, scale = slice(count), bodies
    unknowns = count if instrument == "plate" else own.first + own.scale.size
    parts = []
    for model in models_of(instrument):
        here = rows[model]
        same = here.minimal is main.minimal
        turn = np.eye(count) if same else selection(here.minimal, main.minimal)
        lead = np.zeros((here.minimal.count, unknowns))
        lead[:, :count] = turn * bodies
        noise = plate_noise if model == "reaction" else torque_noise
        channels = list(here.channels())
        load = tuple(basis @ here.delta for _, basis in channels)
        leads = tuple(basis @ lead for _, basis in channels)
        if own.constants is not None and model == "dynamic":
            for c, column in enumerate(load):
                leads[c][:, own.constants + c] = column
        parts.append(
            Part(
                model=model,
                slots=tuple(slots for slots, _ in channels),
                lead=leads,
                weights=noise**-2.0,
                load=load,
                own=None if model == "reaction" else own,
            )
        )
    before = np.zeros((unknowns, unknowns))
    if prior is not None:
        before[:count, :count] = np.linalg.inv(prior) * np.outer(bodies, bodies)
    return Information(names, counted, scale, tuple(parts), before, criterion, reversal)


def models_of(instrument: Instrument) -> tuple[Model, ...]:
    """Whose rows an instrument gives."""
    known: dict[Instrument, tuple[Model, ...]] = {
        "plate": ("reaction",),
        "joints": ("dynamic",),
        "both": ("reaction", "dynamic"),
    }
    return known[instrument]


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
    information: Information,
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
    times = np.arange(count) * motion.period / count
    at = motion.at(times)
    samples = Samples(at.q, at.qd, at.qdd, rows, None)
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
    return Prediction(information.names, relative * information.scale, relative, condition)


def moving(motion: Fourier, count: int, pipeline: Pipeline) -> NDArray[np.bool_]:
    """Whether each joint's rows count at samples of a period, (count, n)."""
    times = np.arange(count) * motion.period / count
    found = np.abs(motion.derivative(times, 1)) > pipeline.resting
    near = round(pipeline.reach * count / motion.period)
    return np.asarray(
        np.all([np.roll(found, shift, axis=0) for shift in range(-near, near + 1)], axis=0)
    )
