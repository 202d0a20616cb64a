"""A recording without some mistakes about positions, and what that leaves open.

Its rows are made once; plate and torques are then judged by algebra: the plate's map by
`plate_map`, order, senses and sizes of the torques by one assignment of their evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.robot.tree import Tree
from testbed.sanity.explanation import Explanation
from testbed.sanity.instants import Instants, delay
from testbed.sanity.mistakes import (
    AS_READ,
    PLATE_ORDERS,
    Frame,
    Mistake,
    merged,
    plain_hypotheses,
)
from testbed.sanity.plate_frame import Hypothesis, frame_hypotheses
from testbed.sanity.plate_map import LATE, SLOPES, PlateRows
from testbed.sanity.torque_choice import Choice, chosen, least
from testbed.sanity.torque_evidence import TorqueEvidence

WEIGHT = 2.5
"""Of the logarithm of a channel's unexplained share [nats]: what is left lasts, and is no noise."""

LEAST_LEFT, LASTS = 1e-4, 10.0
"""Share of a channel's variance that models leave at least, and instants over which it lasts."""

TINY = 1e-5
"""Share below which what is left says nothing more."""

ROUGH = 0.35
"""Sigma of the logarithm of a model file's masses."""

EXPLAINED = 1e-3
"""Share below which, noise aside, nothing is odd about a plate's channel."""

ENOUGH = 0.02
"""Share of a channel above which an explanation is not good enough to stop at."""

MIXED, GAP = 3e-3, 10.0
"""Share that a matrix leaves at most where a plate mixes its channels, and times less than others.
"""

SHIFTED, CLEAR, MOST_SHIFT = 5e-3, 5.0, 50.0
"""Least shift of a plate's frame that is one [m], its sigmas, and and most cost [nats]."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before the data.

    Attributes:
        tree: The robot, its masses roughly right.
        frame: How the mapping has read the plate.
        mean: Barycentric parameters by the model file, (10 n,).
        root: Of their covariance, (10 n, 10 n).
        told: Parameters of a wrench's minimal ones, (10 n, N).
    """

    tree: Tree
    frame: Frame
    mean: Array
    root: Array
    told: Array


class Reading:
    """A recording without some mistakes about positions."""

    def __init__(self, prior: Prior, mistakes: tuple[Mistake, ...], taken: Instants,
                 joints: Array, base: Array) -> None:  # fmt: skip
        """Rows of plate and torques.

        Args:
            prior: The robot, and how the plate was read.
            mistakes: That were undone.
            taken: The instants.
            joints: Rows of the torques on all parameters, (T, n, 10 n).
            base: Rows of the wrench, (T, 6, 10 n).
        """
        self.prior, self.mistakes, self.taken, self.base = prior, mistakes, taken, base
        self.plate = self.torques = None
        if taken.wrench is not None:
            self.plate = PlateRows(base @ prior.told, base @ prior.mean, taken)
        if taken.torque is not None:
            self._joints = joints
            self.torques = self.evidence(prior.mean, prior.root)

    def evidence(self, mean: Array, root: Array) -> TorqueEvidence:
        """Of the torques, with parameters of this mean and root of their covariance."""
        taken = self.taken
        assert taken.torque is not None
        return TorqueEvidence(
            self._joints, mean, root, taken.velocity, taken.acceleration, taken.torque,
            taken.spacing,
        )  # fmt: skip

    @property
    def moved(self) -> bool:
        """Whether its last mistake is a zero."""
        return bool(self.mistakes) and self.mistakes[-1].kind == "zero"

    @cached_property
    def least(self) -> float:
        """Share that no map of the plate can mend; 0 without a plate."""
        return 0.0 if self.plate is None else self.plate.least_share(late=True)

    @cached_property
    def delay(self) -> tuple[float, float]:
        """How late the plate is by the model file's masses [s], and times less that is left then.

        What the masses foretell is held against all maps of the plate's channels.
        """
        taken = self.taken
        if self.plate is None or taken.wrench is None:
            return 0.0, 1.0
        channels = np.hstack([taken.wrench, np.ones((len(taken.wrench), 1))])
        each = np.einsum("tk,cd->tcdk", channels, np.eye(6)).reshape(len(channels), 6, -1)
        late, times = delay(each, self.plate.foretold, taken.spacing)
        return -late, times

    @cached_property
    def linear_share(self) -> float:
        """The same for a plate that is not late."""
        return 0.0 if self.plate is None else self.plate.least_share()

    def mixed(self, left: Array) -> bool:
        """Whether a matrix of all six channels explains the plate far better than what leaves this.

        Args:
            left: Part of each channel's variance, (6,).
        """
        return self.linear_share < min(MIXED, float(left.mean()) / GAP)

    @cached_property
    def own_torques(self) -> Array:
        """Cost of each joint's torques in their order, or in that of the positions, (n,)."""
        if self.torques is None:
            return np.zeros(0)
        same = range(self.prior.tree.n)
        orders = [m.values for m in self.mistakes if m.kind == "position_order"]
        found = [np.array([least(self.torques, j, k)[0] for j, k in zip(same, order, strict=True)])
                 for order in (same, *orders)]  # fmt: skip
        return found[int(np.argmin([float(costs.sum()) for costs in found]))]

    @cached_property
    def misfit(self) -> float:
        """About what the best explanation costs, whatever its mistakes [nats]."""
        plate = 3 * WEIGHT * np.log(self.least) if self.plate is not None else 0.0
        return float(plate + self.own_torques.sum())

    @property
    def bound(self) -> float:
        """The same with what its mistakes must explain."""
        return self.misfit + 2 * sum(each.doubt for each in self.mistakes)

    @cached_property
    def torque_choice(self) -> Choice:
        """Order, senses and sizes of the torques by the model file's masses."""
        return chosen(self.prior.tree, self.torques)

    def with_told_torques(self, each: Explanation, changed: bool) -> Explanation:
        """An explanation of its own, with torques chosen by what the plate has told."""
        if self.torques is None:
            return each
        by_plate = self.torque_choice
        if self.plate is not None:
            by_plate = chosen(self.prior.tree, self.evidence(*self.posterior(each)))
        of_plate = each.cost - self.torque_choice.cost
        if not changed:
            by_plate = by_plate.undoing_nothing()
        kept = [m for m in each.mistakes if not m.kind.startswith("torque")]
        return replace(
            each,
            mistakes=merged((*kept, *by_plate.mistakes)),
            left=np.concatenate([by_plate.left, each.left[len(by_plate.left) :]]),
            unchanged=by_plate.unchanged,
            spread=by_plate.spread,
            cost=of_plate + by_plate.cost,
            sizes=by_plate.sizes,
        )

    def wrench(self, each: Explanation) -> Array:
        """The bedplate's wrench by an explanation of its own, in time, (T, 6)."""
        taken = self.taken
        assert each.map is not None
        assert taken.wrench is not None
        assert taken.wrench_rate is not None
        found: Array = (taken.wrench + each.late * taken.wrench_rate) @ each.map.T
        return found

    def posterior(self, each: Explanation) -> tuple[Array, Array]:
        """Parameters by the varying part of the wrench, (10 n,), and their sigmas' root, (10 n, k).

        Args:
            each: An explanation of its own, with a wrench.
        """
        prior = self.prior
        true = self.wrench(each)
        rest, moved = true - self.base @ prior.mean, self.base @ prior.root
        left = np.maximum(each.left[-6:], LEAST_LEFT) * LASTS
        sigma = np.sqrt(left * np.maximum(true.var(axis=0), 1e-12))
        columns = ((moved - moved.mean(axis=0)) / sigma[:, None]).reshape(-1, moved.shape[2])
        target = ((rest - rest.mean(axis=0)) / sigma).ravel()
        spread, axes = eigh(columns.T @ columns + np.eye(columns.shape[1]))

        scaled = axes / np.sqrt(np.maximum(spread, 1.0))
        root = prior.root @ scaled
        return prior.mean + root @ (scaled.T @ (columns.T @ target)), root

    @cached_property
    def explanations(self) -> list[Explanation]:
        """All that this reading leaves open, judged; of the plate's maps the best forty."""
        if self.plate is None:
            return [self._explained((), np.zeros(0), 0.0, None, 0.0)]
        frame = self.prior.frame
        found = self.of_plate([*frame_hypotheses(self.plate, frame, AS_READ)])
        if not any(each.explained(EXPLAINED) for each in found):
            others = (frame_hypotheses(self.plate, frame, order) for order in PLATE_ORDERS)
            found += self.of_plate([*chain.from_iterable(others)])
        found += self.of_plate(plain_hypotheses(frame))
        return found

    def of_plate(self, hypotheses: Sequence[Hypothesis]) -> list[Explanation]:
        """Explanations by maps of the plate, a shift and lateness fitted."""
        if not hypotheses:
            return []
        assert self.plate is not None
        judged = self.plate.judge([each for _, each in hypotheses])
        size = np.log(np.maximum(np.abs(judged.size), 1e-9)) / ROUGH
        costs = WEIGHT * (np.log(judged.left + TINY).sum(axis=1) + size**2)
        found = []
        for k in np.argsort(costs, kind="stable")[:40]:
            said, each, shift = list(hypotheses[k][0]), hypotheses[k][1], judged.extras[k, :3]
            distance, sigma = (float(np.linalg.norm(x)) for x in (shift, judged.sigma[k, :3]))
            if distance > max(SHIFTED, CLEAR * sigma):
                place = self.prior.frame.place + shift
                said.append(Mistake("shift", (), tuple(np.round(place, 4).tolist())))
            each = each + np.einsum("e,ecd->cd", shift, SLOPES[:3]) @ each
            if judged.size[k] < 0:
                said.append(Mistake("sense"))
                each = -each
            late = float(judged.extras[k, LATE])
            found.append(self._explained(tuple(said), judged.left[k], float(costs[k]), each, late))
        return found

    def _explained(
        self, plate: tuple[Mistake, ...], left: Array, cost: float, each: Array | None, late: float
    ) -> Explanation:
        choice, noise = self.torque_choice, np.zeros(0)
        if self.plate is not None and each is not None:
            noise = self.plate.noise_share(each)
        return Explanation(
            merged((*self.mistakes, *plate, *choice.mistakes)), np.concatenate([choice.left, left]),
            np.concatenate([self.torque_noise, noise]), cost + choice.cost, each, late, self,
            choice.unchanged, choice.spread, choice.sizes,
        )  # fmt: skip

    @cached_property
    def torque_noise(self) -> Array:
        """Part of each torque's variance that is its noise, (n,) or (0,)."""
        if self.taken.torque is None:
            return np.zeros(0)
        share: Array = self.taken.noise[:-6] / np.maximum(self.taken.torque.var(axis=0), 1e-30)
        return share

    def as_read(self) -> Explanation:
        """The plate as it was read; lateness is nobody's mistake."""
        left, cost, late, each = np.zeros(0), 0.0, 0.0, None
        if self.plate is not None:
            each = np.eye(6)
            judged = self.plate.judge([each], [LATE])
            size = np.log(max(judged.size[0], 1e-9)) / ROUGH
            left, late = judged.left[0], float(judged.extras[0, LATE])
            left = left if judged.size[0] > 0 else np.ones(6)  # of a robot of negative masses
            cost = self.shift_cost
            cost += float(WEIGHT * (np.log(left + TINY).sum() + min(size**2, 1e3)))
        return self._explained((), left, cost, each, late)

    @cached_property
    def shift_cost(self) -> float:
        """What the plate's frame where it was read costs beside one that is fitted [nats]."""
        if self.plate is None:
            return 0.0
        fitted = self.plate.judge([np.eye(6)])
        distance, sigma = (float(np.linalg.norm(x[0, :3])) for x in (fitted.extras, fitted.sigma))
        beyond = max(0.0, distance - SHIFTED) / (CLEAR * sigma + 1e-9)
        return min(0.5 * beyond**2, MOST_SHIFT)

    def fine(self, read: Explanation) -> bool:
        """Whether nothing is odd, neither about the plate nor about the torques."""
        if self.shift_cost > 0.5:
            return False
        share = ENOUGH if self.plate is None else EXPLAINED
        told = read.told()
        fits = self.plate is None or not told.odd_torques()
        return read.explained(share) and not told.mistakes and fits
