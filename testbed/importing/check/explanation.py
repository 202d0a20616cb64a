"""A recording by some hypotheses, and how well the robot explains that.

Rows are made once for positions as they are read; plate and torques are then judged by algebra, the
plate by its maps, order, senses and sizes of the torques by one assignment of their evidence.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import linear
from testbed.importing.check.instants import Instants
from testbed.importing.check.plate import WEIGHT, PlateEvidence, PlateExplanation
from testbed.importing.check.plate_frame import Frame
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import Hypothesis, merge, own_joints
from testbed.importing.check.torques import (
    NO_TORQUES,
    TorqueAssignment,
    TorqueEvidence,
    assign,
)

BRAKED = 0.1
"""Share of a torque that the plate's parameters and friction that brakes leave at most."""

APART, ROUGHLY_APART, ANY_APART = 5.0, 12.0, 8.0
"""What each hypothesis must explain, and costs within this are equal; costs that are equal without
a plate, where masses are rough and models of friction are; what each must explain there [nats]."""

ENOUGH = 0.02
"""Share of a torque above which an explanation without a plate is not good enough to stop at."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A recording by some hypotheses: its positions, and what plate and torques then are.

    Attributes:
        fit: Of the positions.
        plate: `NO_PLATE` without one.
        torques: `NO_TORQUES` without them.
    """

    fit: HypothesisFit
    plate: PlateExplanation
    torques: TorqueAssignment

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """In the order in which they are applied."""
        return merge(
            (*self.fit.hypotheses, *self.plate.hypotheses, *self.torques.hypotheses)
        )

    @property
    def has_plate(self) -> bool:
        """Whether there is a plate."""
        return self.fit.plate.measured

    @property
    def cost(self) -> float:
        """Minus the logarithm of how likely it is [nats]."""
        return self.torques.cost + self.plate.cost

    @property
    def unexplained(self) -> Array:
        """Part of each channel's variance, torques first, (C,)."""
        return np.concatenate([self.torques.unexplained, self.plate.unexplained])

    @property
    def noise(self) -> Array:
        """Part of each channel's variance that is its own noise, torques first, (C,)."""
        return np.concatenate([self.fit.torque_noise, self.plate.noise])

    @property
    def price(self) -> float:
        """Its cost, and what its hypotheses must explain besides [nats]."""
        apart = APART if self.has_plate else ANY_APART
        penalties = sum(each.penalty for each in self.hypotheses)
        return self.cost + penalties + apart * self.count

    @property
    def count(self) -> int:
        """How many hypotheses: signs and zeros joint by joint."""
        own = len(own_joints(self.fit.prior.tree))
        each = ("position_sign", "torque_sign", "zero")
        return sum(
            len(h.joints) if h.kind in each and len(h.joints) < own else 1
            for h in self.hypotheses
        )

    @property
    def explained(self) -> bool:
        """Whether nothing is odd about the plate; without one about the torques."""
        return (
            self.plate.explained() if self.has_plate else self.torques_explained(ENOUGH)
        )

    def torques_explained(self, share: float) -> bool:
        """Whether no more is left of the torques, noise aside.

        Args:
            share: Part of a torque's variance that may be left.
        """
        return bool(
            (self.torques.unexplained < share + 3 * self.fit.torque_noise).all()
        )

    @property
    def sized(self) -> bool:
        """Whether half of the torques or more are taken as of another size."""
        odd = sum(len(h.joints) for h in self.hypotheses if h.kind == "torque_size")
        return 2 * odd >= len(self.torques.unexplained) > 0

    def odd_torques(self, sigmas: float = 1.0) -> set[int]:
        """Joints whose torques are odd, once they are in their order and sense.

        With a plate only: without one, masses that are rough leave more.

        Args:
            sigmas: By which parameters that the plate hardly identifies may be off.
        """
        most = BRAKED + 3 * self.fit.torque_noise + sigmas**2 * self.torques.spread
        return set(np.flatnonzero(self.torques.unexplained >= most).tolist())

    @property
    def unclear(self) -> set[int]:
        """Joints whose position may be wrong instead: their torque is odd, or counts as changed."""
        kinds = ("torque_order", "torque_sign")
        changed = {
            k for each in self.hypotheses if each.kind in kinds for k in each.joints
        }
        return self.odd_torques() | changed

    def after_plate(self) -> Explanation:
        """The same with torques judged by the plate's estimate of the parameters."""
        if not self.has_plate or self.fit.torques is None:
            return self
        mean, root, _ = self.fit.plate.posterior(self.plate)
        return replace(self, torques=assign(self.fit.evidence(mean, root)))

    def as_recorded(self) -> Explanation:
        """The same with torques as they were recorded."""
        return replace(self, torques=self.torques.as_recorded())


def ranked(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the best first.

    Args:
        explanations: In any order.
    """
    return sorted(explanations, key=lambda each: each.price)


class HypothesisFit:
    """A recording by some hypotheses about positions and clocks, and what fits then.

    Attributes:
        prior: The robot.
        hypotheses: About positions and clocks.
        instants: Of the recording by these.
        plate: Evidence of maps of the plate's channels.
        torques: Evidence of the torques by the model file's masses, if there are torques.
    """

    def __init__(
        self,
        prior: ScaledPrior,
        frame: Frame,
        hypotheses: tuple[Hypothesis, ...],
        instants: Instants,
    ) -> None:
        """Rows of plate and torques.

        Args:
            prior: The robot.
            frame: How the mapping has read the plate.
            hypotheses: About positions and clocks.
            instants: Of the recording by these.
        """
        self.prior, self.hypotheses, self.instants = prior, hypotheses, instants
        tree = prior.tree
        theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        self._joint_rows, base_rows = linear(tree, instants.motion, theta)
        self.plate = PlateEvidence(prior, frame, base_rows, instants)
        measured = instants.torque.size > 0
        self.torques = self.evidence(prior.mean, prior.root) if measured else None

    def evidence(self, mean: Array, root: Array) -> TorqueEvidence:
        """Of the torques, with parameters of this mean and root of their covariance."""
        return TorqueEvidence(self._joint_rows, mean, root, self.instants)

    @cached_property
    def torque_noise(self) -> Array:
        """Part of each torque's variance that is its noise, (n,) or (0,)."""
        variance = self.instants.torque.var(axis=0)
        return np.asarray(self.instants.torque_noise / np.maximum(variance, 1e-30))

    @cached_property
    def misfit(self) -> float:
        """About what the best explanation costs, whatever its hypotheses [nats].

        Torques count in their own order, or in that of the positions.
        """
        cost = (
            3 * WEIGHT * float(np.log(self.plate.least)) if self.plate.measured else 0.0
        )
        if self.torques is not None:
            orders = [h.values for h in self.hypotheses if h.kind == "position_order"]
            orders.append(tuple(range(self.prior.tree.n)))
            fit = self.torques.fit
            cost += min(
                sum(fit(*place).cost for place in enumerate(each)) for each in orders
            )
        return cost

    @cached_property
    def assignment(self) -> TorqueAssignment:
        """Order, senses and sizes of the torques by the model file's masses."""
        return NO_TORQUES if self.torques is None else assign(self.torques)

    @cached_property
    def explanations(self) -> list[Explanation]:
        """All that is open, the positions being as they are."""
        return [
            Explanation(self, plate, self.assignment)
            for plate in self.plate.explanations
        ]

    @cached_property
    def as_read(self) -> Explanation:
        """The plate as it was read, with torques in the likeliest order, senses and sizes."""
        return Explanation(self, self.plate.as_read, self.assignment)

    @property
    def fine(self) -> bool:
        """Whether nothing is odd as it was read, neither about the plate nor about the torques."""
        if not self.as_read.explained:
            return False
        after = self.as_read.after_plate()
        return not after.hypotheses and not (
            self.plate.measured and after.odd_torques()
        )
