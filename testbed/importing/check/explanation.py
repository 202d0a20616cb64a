"""Explanations of a force plate's data by hypotheses, and their cost.

An explanation is a map of the plate's channels together with hypotheses on mapping errors. The
regressor is computed once for each set of positions; maps of the channels are then compared by
linear algebra.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.dynamics.newton_euler import linear_inverse_dynamics
from testbed.importing.check.instants import Instants
from testbed.importing.check.plate import (
    LOG_RESIDUAL_WEIGHT,
    PlateEvidence,
    PlateExplanation,
)
from testbed.importing.check.plate_frame import PlateFrame
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import (
    Hypothesis,
    joints_without_free_base,
    merge_hypotheses,
)

MIN_HYPOTHESIS_GAIN = 5.0
"""Log-likelihood ratio that each hypothesis must gain; costs within this are equal [nats]."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Explanation of a force plate's data by hypotheses on positions and on the plate.

    Attributes:
        fit: Fits of the plate's data under hypotheses on positions and clocks.
        plate: Map of the plate's channels, with its residual and cost.
    """

    fit: HypothesisFit
    plate: PlateExplanation

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Hypotheses on positions and on the plate, in the order of application."""
        return merge_hypotheses((*self.fit.hypotheses, *self.plate.hypotheses))

    @property
    def cost(self) -> float:
        """Negative log likelihood [nats]."""
        return self.plate.cost

    @property
    def penalised_cost(self) -> float:
        """Negative log likelihood plus the penalties of the hypotheses [nats].

        Each hypothesis costs `MIN_HYPOTHESIS_GAIN` in addition to the penalty of its kind.
        """
        penalties = sum(each.penalty for each in self.hypotheses)
        return self.cost + penalties + MIN_HYPOTHESIS_GAIN * self.hypothesis_count

    @property
    def hypothesis_count(self) -> int:
        """Number of hypotheses; signs and zeros of single joints are counted separately.

        A sign or zero of all joints together counts once.
        """
        joint_count = len(joints_without_free_base(self.fit.prior.tree))
        joint_kinds = ("position_sign", "zero")
        return sum(
            len(h.joints)
            if h.kind in joint_kinds and len(h.joints) < joint_count
            else 1
            for h in self.hypotheses
        )


def rank_explanations(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Sort explanations by increasing penalised cost.

    Args:
        explanations: Explanations in any order.
    """
    return sorted(explanations, key=lambda each: each.penalised_cost)


class HypothesisFit:
    """Fits of a force plate's data under given hypotheses on positions and clocks.

    Attributes:
        prior: Prior of the robot's parameters.
        hypotheses: Hypotheses on positions and clocks.
        instants: Signals of the recording, corrected according to the hypotheses.
        plate: Evidence for maps of the plate's channels.
    """

    def __init__(
        self,
        prior: ScaledPrior,
        frame: PlateFrame,
        hypotheses: tuple[Hypothesis, ...],
        instants: Instants,
    ) -> None:
        """Compute the regressor of the wrench with respect to all barycentric parameters.

        Args:
            prior: Prior of the robot's parameters.
            frame: Frame and units of the plate according to the mapping.
            hypotheses: Hypotheses on positions and clocks.
            instants: Signals of the recording, corrected according to the hypotheses.
        """
        self.prior, self.hypotheses, self.instants = prior, hypotheses, instants
        tree = prior.tree
        theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        base_rows = linear_inverse_dynamics(tree, instants.motion, theta)[1]
        self.plate = PlateEvidence(prior, frame, base_rows, instants)

    @cached_property
    def approximate_cost(self) -> float:
        """Approximate cost of the best fit over all linear maps of the plate [nats]."""
        return 3 * LOG_RESIDUAL_WEIGHT * float(np.log(self.plate.least_residual_share))

    @cached_property
    def explanations(self) -> list[Explanation]:
        """Explanations under these hypotheses on positions, one for each of the best plate maps."""
        return [Explanation(self, plate) for plate in self.plate.explanations]

    @cached_property
    def explanation_as_read(self) -> Explanation:
        """Explanation with the plate as recorded, without hypotheses on the plate."""
        return Explanation(self, self.plate.explanation_as_read)
