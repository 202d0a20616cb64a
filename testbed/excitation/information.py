"""How much a motion tells: the information matrix of the unknowns, and its derivatives.

Unknowns are the minimal parameters, as shares of their values, and what joints have of their
own: dry and viscous friction, which are nuisances. A nuisance is estimated and not counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.arrays import Array
from testbed.excitation.criteria import CRITERIA, CriterionName
from testbed.excitation.sampled_rows import SampledRows
from testbed.excitation.samples import Samples
from testbed.parameters.minimal_set import MinimalSet, selection
from testbed.parameters.rules import Model
from testbed.robot.tree import Tree

Instrument = Literal["plate", "joints", "both"]
"""Whose rows count: the bedplate's wrench, the joints' torques, or all."""

SMALL = 0.05
"""Parameters below this share of the largest of their unit count as that large."""

SMOOTH = 0.05
"""Speed over which the sign of dry friction is smoothed, for derivatives [rad/s or m/s]."""


def relative_scale(minimal: MinimalSet, delta: Array) -> Array:
    """What a relative error is relative to, (N,): the values, small ones counted as larger.

    Args:
        minimal: The parameters.
        delta: Their values, (N,).
    """
    scale = np.abs(delta)
    for unit in set(minimal.units):
        same = np.array([u == unit for u in minimal.units])
        scale[same] = np.maximum(scale[same], SMALL * scale[same].max())
    return scale


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one model in terms of the unknowns.

    Attributes:
        model: Whose rows.
        slots: Of each channel.
        lead: What a channel's slots have of the unknowns, (s, U) each.
        weights: One over the variance of each channel's noise, (channels,).
        friction: First unknown of the joints' own, dry then viscous; None for the plate.
    """

    model: Model
    slots: tuple[slice, ...]
    lead: tuple[Array, ...]
    weights: Array
    friction: int | None


@dataclass(frozen=True, eq=False)
class Information:
    """What is asked of a motion.

    Attributes:
        counted: Number of unknowns that count; the others are nuisances.
        scale: What their relative errors are relative to, (counted,).
        parts: Rows that tell of them.
        prior: Information that is there before, on all unknowns, (U, U), as much as of one
            measurement an instant.
        criterion: By name.
    """

    counted: int
    scale: Array
    parts: tuple[Part, ...]
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
            harmonics: Of the rows, those that count; default all.
        """
        unknowns = len(self.prior)
        total = np.zeros((unknowns, unknowns))
        for part in self.parts:
            for channel, phi in enumerate(self._columns(part, samples)):
                if counted is not None and part.friction is not None:
                    phi *= counted[:, channel, None]
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
        seen = covariance[:, : self.counted]
        by_matrix = seen @ self._judged(covariance)[1] @ seen.T  # times -1
        n = samples.q.shape[1]
        total = np.zeros((3 * n, len(samples.q)))
        for part in self.parts:
            slots = samples.slots[part.model]
            pulled = np.zeros((len(slots), len(samples.q)))
            for c, phi in enumerate(self._columns(part, samples)):
                back = -2 * part.weights[c] * (by_matrix @ phi.T)  # (U, G)
                pulled[part.slots[c]] = part.lead[c] @ back
                if part.friction is not None:
                    dry, viscous = back[part.friction + c], back[part.friction + n + c]
                    total[n + c] += dry * _smooth_sign_slope(samples.qd[:, c]) + viscous
            total += samples.stencil.weights @ np.einsum("sg,seg->eg", pulled, slots)
        return total

    def covariance(self, information: Array) -> Array | None:
        """Of the counted unknowns, as relative errors; None if one is not seen."""
        full = _inverse(information)
        return None if full is None else full[: self.counted, : self.counted]

    def _covariance(self, samples: Samples) -> Array | None:
        return _inverse(self.matrix(samples) + self.prior)

    def _judged(self, covariance: Array) -> tuple[float, Array]:
        return CRITERIA[self.criterion](covariance[: self.counted, : self.counted])

    def _columns(self, part: Part, samples: Samples) -> list[Array]:
        """The rows of each channel on all unknowns, (G, U) each."""
        slots = samples.slots[part.model][:, 0]
        found = [slots[own].T @ lead for own, lead in zip(part.slots, part.lead, strict=True)]
        if part.friction is not None:
            n = len(found)
            for c, phi in enumerate(found):
                phi[:, part.friction + c] = np.tanh(samples.qd[:, c] / SMOOTH)
                phi[:, part.friction + n + c] = samples.qd[:, c]
        return found


def information_of(
    tree: Tree,
    rows: dict[Model, SampledRows],
    instrument: Instrument,
    plate_noise: Array,
    torque_noise: Array,
    criterion: CriterionName = "a",
    prior: Array | None = None,
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
    """
    main = rows["dynamic" if instrument == "joints" else "reaction"]
    scale = relative_scale(main.minimal, main.delta)
    count = len(scale)
    unknowns = count + (0 if instrument == "plate" else 2 * tree.n)
    parts = []
    for model in models_of(instrument):
        here = rows[model]
        same = here.minimal is main.minimal
        turn = np.eye(count) if same else selection(here.minimal, main.minimal)
        lead = np.zeros((here.minimal.count, unknowns))
        lead[:, :count] = turn * scale
        noise = plate_noise if model == "reaction" else torque_noise
        channels = list(here.channels())
        parts.append(
            Part(
                model=model,
                slots=tuple(own for own, _ in channels),
                lead=tuple(basis @ lead for _, basis in channels),
                weights=noise**-2.0,
                friction=None if model == "reaction" else count,
            )
        )
    before = np.zeros((unknowns, unknowns))
    if prior is not None:
        before[:count, :count] = np.linalg.inv(prior) * np.outer(scale, scale)
    return Information(count, scale, tuple(parts), before, criterion)


def models_of(instrument: Instrument) -> tuple[Model, ...]:
    """Whose rows an instrument gives."""
    known: dict[Instrument, tuple[Model, ...]] = {
        "plate": ("reaction",),
        "joints": ("dynamic",),
        "both": ("reaction", "dynamic"),
    }
    return known[instrument]


def _smooth_sign_slope(qd: Array) -> Array:
    return np.asarray((1 - np.tanh(qd / SMOOTH) ** 2) / SMOOTH)


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
