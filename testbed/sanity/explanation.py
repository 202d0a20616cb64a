"""What a recording would be without some mistakes, and how well the robot explains that."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from testbed.arrays import Array
from testbed.sanity.mistakes import Mistake, own_joints

if TYPE_CHECKING:
    from testbed.sanity.position_reading import Reading

BRAKED = 0.1
"""Share of a torque that the plate's parameters and friction that brakes leave at most."""

SIGMAS = 3.0
"""Standard deviations by which parameters that the plate tells little of may be off."""

APART, ROUGHLY_APART, ANY_APART = 5.0, 12.0, 8.0
"""Explanations within this of the best are not told apart, and the one with the fewest mistakes is
taken; the same without a plate, where masses are rough and models of friction are; the same of
none at all [nats]."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """What a recording would be without some mistakes, and how well the robot explains that.

    Attributes:
        mistakes: That were undone.
        left: Part of each channel's variance that is not explained, torques first, (C,).
        noise: Part of it that is the channels' own noise, (C,).
        cost: Minus the logarithm of how likely it is [nats].
        map: From the recorded wrench to the bedplate's, (6, 6), if there is a wrench.
        late: How late the wrench is [s].
        reading: Of the positions.
        unchanged: What is left of the torques where only theirs are not undone, (n,) or (0,).
        spread: Part of each torque's variance by which parameters may move it, (n,) or (0,).
        sizes: Times what the masses make that torques are; nan where not told, (n,) or (0,).
    """

    mistakes: tuple[Mistake, ...]
    left: Array
    noise: Array
    cost: float
    map: Array | None
    late: float
    reading: Reading
    unchanged: Array
    spread: Array
    sizes: Array

    @property
    def count(self) -> int:
        """How many mistakes: signs and zeros joint by joint."""
        own = len(own_joints(self.reading.prior.tree))
        each = ("position_sign", "torque_sign", "zero")
        return sum(
            len(m.joints) if m.kind in each and len(m.joints) < own else 1 for m in self.mistakes
        )

    @property
    def timed(self) -> tuple[Mistake, ...]:
        """Its mistakes, a late plate's with what was found beside."""
        return tuple(
            replace(m, values=(m.values[0] + self.late,)) if m.kind == "late" else m
            for m in self.mistakes
        )

    @property
    def price(self) -> float:
        """Its cost, and what its mistakes must explain besides [nats]."""
        return self.cost + sum(each.doubt for each in self.mistakes)

    def explained(self, share: float) -> bool:
        """Whether nothing is odd, noise aside.

        Args:
            share: Part of a channel's variance that may be left.
        """
        return bool((self.left < share + 3 * self.noise)[-6 if self.map is not None else 0 :].all())

    def told(self, *, changed: bool = True) -> Explanation:
        """The same with torques held against what the plate has told of the parameters.

        Args:
            changed: Whether mistakes of theirs are undone.
        """
        return self.reading.with_told_torques(self, changed)

    @property
    def sized(self) -> bool:
        """Whether half of the torques or more are taken as of another size."""
        odd = sum(len(each.joints) for each in self.mistakes if each.kind == "torque_size")
        return 2 * odd >= len(self.unchanged) > 0

    def odd_torques(self, sigmas: float = 1.0) -> set[int]:
        """Joints whose torques are odd, once they are in their order and sense.

        With a plate only: without one, masses that are rough leave more.

        Args:
            sigmas: By which parameters that the plate tells little of may be off.
        """
        count = len(self.unchanged)
        most = BRAKED + 3 * self.noise[:count] + sigmas**2 * self.spread
        return set(np.flatnonzero(self.left[:count] >= most).tolist())

    @property
    def unclear(self) -> set[int]:
        """Joints whose position may be wrong instead: their torque is odd, or counts as changed."""
        kinds = ("torque_order", "torque_sign")
        changed = {k for each in self.mistakes if each.kind in kinds for k in each.joints}
        return self.odd_torques() | changed

    @property
    def tolerance(self) -> float:
        """A cost that is higher by this is not told apart from the least [nats]."""
        if self.map is not None:
            return APART
        return ROUGHLY_APART if self.mistakes else ANY_APART

    @property
    def rank(self) -> float:
        """What decides among those that explain as much."""
        return self.count * (ANY_APART if self.map is None else APART) + self.price


def ranked(found: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the best first: of those that explain about as much the simplest."""
    several = list(found)
    least = min(each.price for each in several)

    def order(each: Explanation) -> tuple[bool, float]:
        worse = each.price >= least + each.tolerance
        return worse, each.price if worse else each.rank

    return sorted(several, key=order)
