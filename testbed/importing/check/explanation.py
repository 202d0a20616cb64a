"""A plate by some hypotheses, and how well the robot explains it.

Rows are made once for positions as they are read; the plate is then judged by algebra, by its maps.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from testbed.core.dynamics.newton_euler import linear
from testbed.importing.check.instants import Instants
from testbed.importing.check.plate import WEIGHT, PlateEvidence, PlateExplanation
from testbed.importing.check.plate_frame import Frame
from testbed.importing.check.prior import ScaledPrior
from testbed.importing.check.remedies import Hypothesis, merge, own_joints

APART = 5.0
"""What each hypothesis must explain, and costs within this are equal [nats]."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A plate by some hypotheses: positions, and what the plate then is.

    Attributes:
        fit: Of the positions.
        plate: By a map of its channels.
    """

    fit: HypothesisFit
    plate: PlateExplanation

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """In the order in which they are applied."""
        return merge((*self.fit.hypotheses, *self.plate.hypotheses))

    @property
    def cost(self) -> float:
        """Minus the logarithm of how likely it is [nats]."""
        return self.plate.cost

    @property
    def price(self) -> float:
        """Its cost, and what its hypotheses must explain besides [nats]."""
        penalties = sum(each.penalty for each in self.hypotheses)
        return self.cost + penalties + APART * self.count

    @property
    def count(self) -> int:
        """How many hypotheses: signs and zeros joint by joint."""
        own = len(own_joints(self.fit.prior.tree))
        each = ("position_sign", "zero")
        return sum(
            len(h.joints) if h.kind in each and len(h.joints) < own else 1
            for h in self.hypotheses
        )


def ranked(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the best first.

    Args:
        explanations: In any order.
    """
    return sorted(explanations, key=lambda each: each.price)


class HypothesisFit:
    """A plate by some hypotheses about positions and clocks, and what fits then.

    Attributes:
        prior: The robot.
        hypotheses: About positions and clocks.
        instants: Of the recording by these.
        plate: Evidence of maps of the plate's channels.
    """

    def __init__(
        self,
        prior: ScaledPrior,
        frame: Frame,
        hypotheses: tuple[Hypothesis, ...],
        instants: Instants,
    ) -> None:
        """Rows of the plate.

        Args:
            prior: The robot.
            frame: How the mapping has read the plate.
            hypotheses: About positions and clocks.
            instants: Of the recording by these.
        """
        self.prior, self.hypotheses, self.instants = prior, hypotheses, instants
        tree = prior.tree
        theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        base_rows = linear(tree, instants.motion, theta)[1]
        self.plate = PlateEvidence(prior, frame, base_rows, instants)

    @cached_property
    def misfit(self) -> float:
        """About what the best explanation costs, whatever its hypotheses [nats]."""
        return 3 * WEIGHT * float(np.log(self.plate.least))

    @cached_property
    def explanations(self) -> list[Explanation]:
        """All that is open, the positions being as they are."""
        return [Explanation(self, plate) for plate in self.plate.explanations]

    @cached_property
    def as_read(self) -> Explanation:
        """The plate as it was read."""
        return Explanation(self, self.plate.as_read)
