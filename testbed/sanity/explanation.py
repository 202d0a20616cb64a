"""A recording by some hypotheses, and how well the robot explains that.

Rows are made once for positions as they are read; plate and torques are then judged by algebra, the
plate by its maps, order, senses and sizes of the torques by one assignment of their evidence.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.sanity.hypotheses import Hypothesis, merge, own_joints
from testbed.sanity.instants import Instants
from testbed.sanity.plate import WEIGHT, Frame, PlateEvidence, PlateExplanation
from testbed.sanity.prior import Prior
from testbed.sanity.torques import NO_TORQUES, TorqueAssignment, TorqueEvidence, assign

BRAKED = 0.1
"""Share of a torque that the plate's parameters and friction that brakes leave at most."""

APART, ROUGHLY_APART, ANY_APART = 5.0, 12.0, 8.0
"""Explanations within this of the best are not told apart, and the one with the fewest hypotheses
is taken; the same without a plate, where masses are rough and models of friction are; the same of
none at all [nats]."""

ENOUGH = 0.02
"""Share of a torque above which an explanation without a plate is not good enough to stop at."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A recording by some hypotheses: its positions, and what plate and torques then are.

    Attributes:
        fit: Of the positions.
        plate: None without one.
        torques: None of them without torques.
    """

    fit: HypothesisFit
    plate: PlateExplanation | None
    torques: TorqueAssignment

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """In the order in which they are applied."""
        plate = () if self.plate is None else self.plate.hypotheses
        return merge((*self.fit.hypotheses, *plate, *self.torques.hypotheses))

    @property
    def cost(self) -> float:
        """Minus the logarithm of how likely it is [nats]."""
        return self.torques.cost + (0.0 if self.plate is None else self.plate.cost)

    @property
    def unexplained(self) -> Array:
        """Part of each channel's variance, torques first, (C,)."""
        plate = () if self.plate is None else self.plate.unexplained
        return np.concatenate([self.torques.unexplained, plate])

    @property
    def noise(self) -> Array:
        """Part of each channel's variance that is its own noise, torques first, (C,)."""
        plate = () if self.plate is None else self.plate.noise
        return np.concatenate([self.fit.torque_noise, plate])

    @property
    def price(self) -> float:
        """Its cost, and what its hypotheses must explain besides [nats]."""
        return self.cost + sum(each.penalty for each in self.hypotheses)

    @property
    def count(self) -> int:
        """How many hypotheses: signs and zeros joint by joint."""
        own = len(own_joints(self.fit.prior.tree))
        each = ("position_sign", "torque_sign", "zero")
        return sum(
            len(h.joints) if h.kind in each and len(h.joints) < own else 1 for h in self.hypotheses
        )

    @property
    def tolerance(self) -> float:
        """A cost that is higher by this is not told apart from the least [nats]."""
        if self.plate is not None:
            return APART
        return ROUGHLY_APART if self.hypotheses else ANY_APART

    @property
    def rank(self) -> float:
        """What decides among those that explain as much."""
        return self.count * (ANY_APART if self.plate is None else APART) + self.price

    @property
    def explained(self) -> bool:
        """Whether nothing is odd about the plate; without one about the torques."""
        return self.torques_explained(ENOUGH) if self.plate is None else self.plate.explained()

    def torques_explained(self, share: float) -> bool:
        """Whether no more is left of the torques, noise aside.

        Args:
            share: Part of a torque's variance that may be left.
        """
        return bool((self.torques.unexplained < share + 3 * self.fit.torque_noise).all())

    @property
    def sized(self) -> bool:
        """Whether half of the torques or more are taken as of another size."""
        odd = sum(len(h.joints) for h in self.hypotheses if h.kind == "torque_size")
        return 2 * odd >= len(self.torques.unexplained) > 0

    def odd_torques(self, sigmas: float = 1.0) -> set[int]:
        """Joints whose torques are odd, once they are in their order and sense.

        With a plate only: without one, masses that are rough leave more.

        Args:
            sigmas: By which parameters that the plate tells little of may be off.
        """
        most = BRAKED + 3 * self.fit.torque_noise + sigmas**2 * self.torques.spread
        return set(np.flatnonzero(self.torques.unexplained >= most).tolist())

    @property
    def unclear(self) -> set[int]:
        """Joints whose position may be wrong instead: their torque is odd, or counts as changed."""
        kinds = ("torque_order", "torque_sign")
        changed = {k for each in self.hypotheses if each.kind in kinds for k in each.joints}
        return self.odd_torques() | changed

    def after_plate(self) -> Explanation:
        """The same with torques judged by what the plate tells of the parameters."""
        evidence = self.fit.plate
        if self.plate is None or evidence is None or self.fit.torques is None:
            return self
        return replace(self, torques=assign(self.fit.evidence(*evidence.posterior(self.plate))))

    def as_recorded(self) -> Explanation:
        """The same with torques as they were recorded."""
        return replace(self, torques=self.torques.as_recorded())


def ranked(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the best first: of those that explain about as much the simplest.

    Args:
        explanations: At least one.
    """
    several = list(explanations)
    least = min(each.price for each in several)

    def order(each: Explanation) -> tuple[bool, float]:
        worse = each.price >= least + each.tolerance
        return worse, each.price if worse else each.rank

    return sorted(several, key=order)


class HypothesisFit:
    """A recording by some hypotheses about positions and clocks, and what fits then.

    Attributes:
        prior: The robot.
        hypotheses: About positions and clocks.
        instants: Of the recording by these.
        plate: Evidence of maps of the plate's channels, if there is a plate.
        torques: Evidence of the torques by the model file's masses, if there are torques.
    """

    def __init__(
        self, prior: Prior, frame: Frame, hypotheses: tuple[Hypothesis, ...], instants: Instants
    ) -> None:
        """Rows of plate and torques.

        Args:
            prior: The robot.
            frame: How the mapping has read the plate.
            hypotheses: About positions and clocks.
            instants: Of the recording by these.
        """
        self.prior, self.hypotheses, self.instants = prior, hypotheses, instants
        self.plate = self.torques = None
        time = np.arange(len(instants.position), dtype=np.float64) * instants.spacing
        motion = Motion(time, instants.position, instants.velocity, instants.acceleration)
        tree = prior.tree
        theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        self._joint_rows, base_rows = linear(tree, motion, theta)
        if instants.wrench.size:
            self.plate = PlateEvidence(prior, frame, base_rows, instants)
        if instants.torque.size:
            self.torques = self.evidence(prior.mean, prior.root)

    def evidence(self, mean: Array, root: Array) -> TorqueEvidence:
        """Of the torques, with parameters of this mean and root of their covariance."""
        return TorqueEvidence(self._joint_rows, mean, root, self.instants)

    @cached_property
    def torque_noise(self) -> Array:
        """Part of each torque's variance that is its noise, (n,) or (0,)."""
        variance = self.instants.torque.var(axis=0)
        share: Array = self.instants.torque_noise / np.maximum(variance, 1e-30)
        return share

    @property
    def least(self) -> float:
        """Share that no map of the plate can mend; 0 without a plate."""
        return 0.0 if self.plate is None else self.plate.least

    @cached_property
    def misfit(self) -> float:
        """About what the best explanation costs, whatever its hypotheses [nats].

        Torques count in their own order, or in that of the positions.
        """
        cost = 3 * WEIGHT * float(np.log(self.least)) if self.plate is not None else 0.0
        if self.torques is not None:
            fit, same = self.torques.fit, range(self.prior.tree.n)
            orders = [same, *(h.values for h in self.hypotheses if h.kind == "position_order")]
            cost += min(
                sum(fit(j, k).cost for j, k in zip(same, each, strict=True)) for each in orders
            )
        return cost

    @property
    def bound(self) -> float:
        """The same with what its hypotheses must explain."""
        return self.misfit + 2 * sum(each.penalty for each in self.hypotheses)

    @cached_property
    def assignment(self) -> TorqueAssignment:
        """Order, senses and sizes of the torques by the model file's masses."""
        return NO_TORQUES if self.torques is None else assign(self.torques)

    @cached_property
    def explanations(self) -> list[Explanation]:
        """All that is open, the positions being as they are."""
        plates = [None] if self.plate is None else self.plate.explanations
        return [Explanation(self, plate, self.assignment) for plate in plates]

    @cached_property
    def as_read(self) -> Explanation:
        """The plate as it was read, with torques in the likeliest order, senses and sizes."""
        plate = None if self.plate is None else self.plate.as_read
        return Explanation(self, plate, self.assignment)

    @property
    def fine(self) -> bool:
        """Whether nothing is odd as it was read, neither about the plate nor about the torques."""
        shifted = self.plate is not None and self.plate.shift_cost > 0.5
        if shifted or not self.as_read.explained:
            return False
        after = self.as_read.after_plate()
        return not after.hypotheses and (self.plate is None or not after.odd_torques())
