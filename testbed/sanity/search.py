"""Which mistakes explain a recording: readings of the positions, each with all that it leaves open.

A reading is the recording without some mistakes about positions. Its rows are made once; plate and
torques are then judged by algebra: the plate's map by `plate_map`, order, senses and sizes of the
torques by one assignment of their evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import minimal_set
from testbed.recordings.importing.foreign_units import FORCES, MOMENTS
from testbed.robot.free_base import FREE, coordinates, poses
from testbed.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.robot.tree import Tree
from testbed.sanity.instants import Instants, instants
from testbed.sanity.mistakes import (
    AS_READ,
    MOST_JOINTS,
    PLATE_ORDERS,
    QUARTERS,
    STEPS,
    Frame,
    Mistake,
    joint_map,
    merged,
    own_joints,
    plate_hypotheses,
    position_hypotheses,
    rarer_hypotheses,
    turned,
)
from testbed.sanity.plate_map import LATE, SHIFT, SLOPES, TURN, PlateRows, placed
from testbed.sanity.torque_evidence import TorqueEvidence, prior_root

Progress = Callable[[int, int], None]

WEIGHT = 2.5
"""Of the logarithm of a channel's unexplained share [nats]: what is left lasts, and is no noise."""

LEAST_LEFT, LASTS = 1e-4, 10.0
"""Share of a channel's variance that models leave at least, and instants over which it lasts."""

TINY = 1e-5
"""Share below which what is left says nothing more."""

ROUGH = 0.35
"""Sigma of the logarithm of a model file's masses."""

SIGN, GAIN, ORDER = 3.0, 8.0, 5.0
"""What a torque of the other sense, one of another size, and another order must explain [nats]."""

LARGE = 2.5
"""Times that a torque may be too large or too small and count as being of its size."""

TOLERANCE = 5.0
"""Among explanations within this of the best the one with the fewest mistakes is taken [nats]."""

EXPLAINED = 1e-3
"""Share below which, noise aside, nothing is odd about a plate's channel."""

ENOUGH = 0.02
"""Share of a channel above which an explanation is not good enough to stop at."""

DOUBTED = 10.0
"""Gain of a single mistake below which no others are looked for where there is no plate [nats]."""

GOOD = 0.3
"""Share of a torque above which rarer mistakes are looked for where there is no plate."""

MUCH = 20.0
"""Times more than the least that some map of a plate leaves of another reading: it is none."""

READ = 4
"""Readings whose plates are judged; the others cannot come up to them."""

SHIFTED, CLEAR, MOST_SHIFT = 5e-3, 5.0, 50.0
"""Least shift of a plate's frame that is one [m], its sigmas, and what one counts at most [nats]."""

BRAKED = 0.1
"""Share of a torque that the plate's parameters and friction that brakes leave of right positions."""

SNAPPED = 0.02
"""Distance of a turn's matrix to one by multiples of 15 degrees from which that is tried."""

SAID = 6
"""Explanations that are kept, the best first."""

UNITS = ("degrees", "radians", "base_unit", "quaternion_order")
"""Mistakes that concern all joints, which are looked at before those of some."""

ALIKE = 0.2
"""By how much the turns of forces and of moments in the best map may differ."""

NEAR = 0.1
"""By how much the ratio of gains in the best map may be off for a pair of units to be tried."""


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
        sizes: Times what the masses make that torques are; nan where they do not tell, (n,) or (0,).
    """

    mistakes: tuple[Mistake, ...]
    left: Array
    noise: Array
    cost: float
    map: Array | None
    late: float
    reading: Reading
    unchanged: Array
    sizes: Array

    @property
    def count(self) -> int:
        """How many mistakes: signs and zeros joint by joint."""
        own = len(own_joints(self.reading.search.tree))
        each = ("position_sign", "torque_sign", "zero")
        return sum(
            len(m.joints) if m.kind in each and len(m.joints) < own else 1 for m in self.mistakes
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
    def wrong_torques(self) -> bool:
        """Whether a torque's order or sense is undone: the positions' may be wrong as well."""
        return any(each.kind in ("torque_order", "torque_sign") for each in self.mistakes)

    @property
    def rank(self) -> float:
        """What decides among those that explain as much."""
        return self.count * TOLERANCE + self.price


class Search:
    """All readings of a recording that were looked at."""

    def __init__(self, tree: Tree, signals: tuple[Array, Array | None, Array | None], rate: float,
                 offset: Array, frame: Frame, progress: Progress | None = None) -> None:  # fmt: skip
        """Nothing yet.

        Args:
            tree: The robot, its masses roughly right.
            signals: Position (M, n), torque (M, n), wrench (M, 6); the last two if measured.
            rate: Samples a second [Hz].
            offset: What the mapping has added to the positions, (n,).
            frame: How the mapping has read the plate.
            progress: Told how many readings are done, and of how many.
        """
        self.tree, self.frame, self.progress = tree, frame, progress
        self._signals, self._rate, self._offset = signals, rate, offset
        self._theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        self._told = minimal_set(tree, "reaction").lift
        self.mean, self.root = barycentric(tree).ravel(), prior_root(tree)
        self.readings: dict[tuple[Mistake, ...], Reading] = {}
        self.given = instants(*signals, rate)
        self.plate = signals[2] is not None

    def read(self, mistakes: tuple[Mistake, ...], taken: Instants) -> Reading:
        """A reading, made once."""
        if mistakes not in self.readings:
            time = np.arange(len(taken.position)) * taken.spacing
            motion = Motion(time, taken.position, taken.velocity, taken.acceleration)
            joints, base = linear(self.tree, motion, self._theta)
            self.readings[mistakes] = Reading(self, mistakes, taken, joints, base)
        return self.readings[mistakes]

    def without(self, beside: Reading, mistake: Mistake) -> Reading | None:
        """A reading with one mistake less about positions; None where it is no motion."""
        if mistake.kind != "quaternion_order":
            scale, added = joint_map(mistake, self.tree.n, self._offset)
            taken: Instants | None = beside.taken.moved(scale, added)
        else:
            position, *others = self._signals
            pose = poses(position[:, :FREE])
            pose[:, 3:] = pose[:, 3:][:, list(mistake.values)]
            try:
                moved = np.hstack([coordinates(pose), position[:, FREE:]])
            except RecordingError:  # the base would stand on its head
                return None
            taken = instants(moved, others[0], others[1], self._rate)
        return None if taken is None else self.read((*beside.mistakes, mistake), taken)

    def best(self) -> tuple[Explanation, list[Explanation]]:
        """The recording as it is, and what explains it, the best first."""
        assert self.given is not None
        given = self.read((), self.given)
        as_read = given.as_read()
        as_given = as_read.told(changed=False)
        if given.fine(as_read):
            return as_given, [as_given]
        found = ranked(self._found(given, as_read))
        return as_given, ranked(each.told() for each in found[:SAID])

    def _found(self, given: Reading, best: Explanation) -> list[Explanation]:
        """What may explain it, from the simple to the rare; no more once all is explained."""
        several = [best]

        def done(found: Iterable[Explanation], share: float | None = None) -> bool:
            several.extend(found)
            likeliest = min(several, key=lambda each: each.cost)
            if share is not None:
                return likeliest.explained(share)
            return self.plate and likeliest.explained(EXPLAINED) and not likeliest.told().wrong_torques

        hypotheses = list(position_hypotheses(self.tree, given.taken.position, ()))
        units = [each for each in hypotheses if each.kind in UNITS]
        if done(given.explanations(2)) or done(given.any_turn()):
            return several
        self._look(given, units)
        if units and done(self._judged(2)):
            return several
        self._look(given, hypotheses)
        if not self.plate:
            done(self._judged(1))
            gain = several[0].told(changed=False).cost - min(each.cost for each in several)
            if gain < DOUBTED or done((), GOOD):
                return several
        if done(self._judged(2)) or done(self._turned(), ENOUGH) or done(self._judged(3), ENOUGH):
            return several
        if self.plate and given.linear_share < EXPLAINED:  # a matrix explains it: positions are right
            return several
        for each in self._nearest(2 if self.plate else 4):
            self._look(each, position_hypotheses(self.tree, each.taken.position, each.mistakes))
        if done(self._judged(2), ENOUGH) or done(self._turned(), ENOUGH):
            return several
        self._look(given, rarer_hypotheses(self.tree, pairs=not self.plate))
        zeros = [each for each in self._nearest(3) if each.rare]
        done(self._judged(1))
        done(chain.from_iterable(self._refined(each).explanations(1) for each in zeros))
        return several

    def _look(self, beside: Reading, hypotheses: Iterable[Mistake]) -> None:
        several = list(hypotheses)
        for done, each in enumerate(several, 1):
            self.without(beside, each)
            if self.progress is not None:
                self.progress(done, len(several))

    def _nearest(self, count: int) -> list[Reading]:
        return sorted(self.readings.values(), key=lambda each: each.bound)[:count]

    def _judged(self, kinds: int) -> list[Explanation]:
        """What the readings leave that may be the best."""
        return list(chain.from_iterable(each.explanations(kinds) for each in self._promising()))

    def _turned(self) -> list[Explanation]:
        """The same with a plate's frame turned by any angle."""
        return list(chain.from_iterable(each.any_turn() for each in self._promising()[:3]))

    def _promising(self) -> list[Reading]:
        """The nearest readings, but for those that no map of a plate could explain as well."""
        nearest = self._nearest(READ)
        least = MUCH * min((each.least for each in nearest), default=0.0) + EXPLAINED
        return [each for each in nearest if each.least <= least]

    def _refined(self, reading: Reading) -> Reading:
        """A reading whose last zero is the best angle, not one that was tried."""
        *before, last = reading.mistakes
        for width in np.deg2rad([12, 6, 3, 1.5, 0.7]):
            for side in (-width, width):
                scale, added = np.eye(self.tree.n), np.zeros(self.tree.n)
                added[list(last.joints)] = side
                values = tuple(angle + side for angle in last.values)
                moved = (*before, Mistake(last.kind, last.joints, values))
                tried = self.read(moved, reading.taken.moved(scale, added))
                if tried.bound < reading.bound:
                    reading, last = tried, tried.mistakes[-1]
        return reading


class Reading:
    """A recording without some mistakes about positions."""

    def __init__(self, search: Search, mistakes: tuple[Mistake, ...], taken: Instants,
                 joints: Array, base: Array) -> None:  # fmt: skip
        """Rows of plate and torques.

        Args:
            search: Which one it is of.
            mistakes: That were undone.
            taken: The instants.
            joints: Rows of the torques on all parameters, (T, n, 10 n).
            base: Rows of the wrench, (T, 6, 10 n).
        """
        self.search, self.mistakes, self.taken, self.base = search, mistakes, taken, base
        self.plate = self.torques = None
        if taken.wrench is not None:
            self.plate = PlateRows(base @ search._told, base @ search.mean, taken)
        if taken.torque is not None:
            self._joints = joints
            self.torques = self.evidence(search.mean, search.root)

    def evidence(self, mean: Array, root: Array) -> TorqueEvidence:
        """Of the torques, with parameters of this mean and root of their covariance."""
        taken = self.taken
        assert taken.torque is not None
        return TorqueEvidence(
            self._joints, mean, root, taken.velocity, taken.acceleration, taken.torque,
            taken.spacing,
        )  # fmt: skip

    @property
    def rare(self) -> bool:
        """Whether its last mistake is a zero that is no quarter turn."""
        last = self.mistakes[-1:]
        return any(each.kind == "zero" and not set(each.values) <= set(QUARTERS) for each in last)

    @cached_property
    def least(self) -> float:
        """Share that no map of the plate can mend; 0 without a plate."""
        return 0.0 if self.plate is None else float(self.plate.best_map(late=True)[0][0])

    @cached_property
    def linear_share(self) -> float:
        """The same for a plate that is not late."""
        return 0.0 if self.plate is None else float(self.plate.best_map()[0][0])

    @cached_property
    def own_torques(self) -> Array:
        """Cost of each joint's torques in their order, or in that of the positions, (n,)."""
        if self.torques is None:
            return np.zeros(0)
        same = range(self.search.tree.n)
        orders = [m.values for m in self.mistakes if m.kind == "position_order"]
        found = [np.array([least(self.torques, j, k)[0] for j, k in zip(same, order, strict=True)])
                 for order in (same, *orders)]  # fmt: skip
        return min(found, key=lambda costs: float(costs.sum()))

    @cached_property
    def bound(self) -> float:
        """About what the best explanation costs."""
        plate = 3 * WEIGHT * np.log(self.least) if self.plate is not None else 0.0
        doubt = sum(each.doubt for each in self.mistakes)
        return float(plate + self.own_torques.sum() + 2 * doubt)


    @cached_property
    def torque_choice(self) -> Choice:
        """Order, senses and sizes of the torques by the model file's masses."""
        return chosen(self.search.tree, self.torques)

    def with_told_torques(self, each: Explanation, changed: bool) -> Explanation:
        """An explanation of its own, with torques chosen by what the plate has told."""
        if self.torques is None:
            return each
        by_plate = self.torque_choice
        if self.plate is not None:
            by_plate = chosen(self.search.tree, self.evidence(*self.posterior(each)))
        of_plate = each.cost - self.torque_choice.cost
        if not changed:
            by_plate = by_plate.undoing_nothing()
        kept = [m for m in each.mistakes if not m.kind.startswith("torque")]
        return replace(
            each,
            mistakes=merged((*kept, *by_plate.mistakes)),
            left=np.concatenate([by_plate.left, each.left[len(by_plate.left) :]]),
            unchanged=by_plate.unchanged,
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
        search = self.search
        true = self.wrench(each)
        rest, moved = true - self.base @ search.mean, self.base @ search.root
        left = np.maximum(each.left[-6:], LEAST_LEFT) * LASTS
        sigma = np.sqrt(left * np.maximum(true.var(axis=0), 1e-12))
        columns = ((moved - moved.mean(axis=0)) / sigma[:, None]).reshape(-1, moved.shape[2])
        target = ((rest - rest.mean(axis=0)) / sigma).ravel()
        covariance = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
        values = covariance @ (columns.T @ target)
        return search.mean + search.root @ values, search.root @ np.linalg.cholesky(covariance)

    def explanations(self, kinds: int) -> list[Explanation]:
        """All that this reading leaves open, judged; of the plate's maps the best forty.

        Args:
            kinds: Mistakes about a plate at once, at most.
        """
        if self.plate is None:
            return [self._explained((), np.zeros(0), 0.0, None, 0.0)]
        several = list(plate_hypotheses(self.search.frame, kinds))
        return self._of_plate([m for m, _ in several], [a for _, a in several])

    def _of_plate(
        self, mistakes: Sequence[tuple[Mistake, ...]], maps: Sequence[Array],
        free: Sequence[int] = (*SHIFT, LATE),
    ) -> list[Explanation]:  # fmt: skip
        """Explanations by maps of the plate, a shift and lateness fitted."""
        assert self.plate is not None
        judged = self.plate.judge(maps, free)
        size = np.log(np.maximum(np.abs(judged.size), 1e-9)) / ROUGH
        costs = WEIGHT * (np.log(judged.left + TINY).sum(axis=1) + size**2)
        found = []
        for k in np.argsort(costs, kind="stable")[:40]:
            said, each, shift = list(mistakes[k]), maps[k], judged.extras[k, :3]
            distance, sigma = np.linalg.norm(shift), np.linalg.norm(judged.sigma[k, :3])
            if distance > max(SHIFTED, CLEAR * sigma):
                place = self.search.frame.place + shift
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
        choice = self.torque_choice
        mistakes = merged((*self.mistakes, *plate, *choice.mistakes))
        return self._left(mistakes, choice.left, left, cost + choice.cost, each, late)

    def _left(self, mistakes: tuple[Mistake, ...], torques: Array, left: Array, cost: float,
              each: Array | None, late: float) -> Explanation:  # fmt: skip
        noise = np.zeros(0)
        if self.plate is not None and each is not None:
            noise = self.plate.noise_share(each)
        choice = self.torque_choice
        return Explanation(
            mistakes, np.concatenate([torques, left]), np.concatenate([self.torque_noise, noise]),
            cost, each, late, self, choice.unchanged, choice.sizes,
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
        """What the plate's frame, taken to lie where it was read, costs beside one that is fitted."""
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
        torques = (told.left < BRAKED + 3 * told.noise)[: len(told.unchanged)]
        return read.explained(share) and not told.mistakes and (self.plate is None or bool(torques.all()))

    def any_turn(self) -> list[Explanation]:
        """Explanations by a frame turned by any angle: that of the best map of all, refined."""
        from scipy.linalg import polar

        if self.plate is None:
            return []
        frame, found = self.search.frame, []
        blind = self.plate.best_map()[1] @ placed(frame.turn, frame.place)
        given = MOMENTS[frame.units[1]] / FORCES[frame.units[0]]
        for order in (AS_READ, *PLATE_ORDERS):
            ordered = blind @ np.eye(6)[list(order)].T
            (turn, forces), (other, moments) = (polar(ordered[k : k + 3, k : k + 3]) for k in (0, 3))
            if np.linalg.det(turn) < 0 or np.linalg.norm(turn - other) > ALIKE:
                continue
            ratio = np.trace(moments) / np.trace(forces) * given
            for units in product(FORCES, MOMENTS):
                if abs(MOMENTS[units[1]] / FORCES[units[0]] / ratio - 1) < NEAR:
                    found += self._turned_near(turn, units, order)
        return found

    def _turned_near(self, turn: Array, units: tuple[str, str], order: tuple[int, ...]
                     ) -> list[Explanation]:  # fmt: skip
        """Explanations by a frame turned about so, and by what a person would write of it."""
        assert self.plate is not None
        frame = self.search.frame
        for _ in range(3):
            judged = self.plate.judge([frame.map(turn, units, order)], (*SHIFT, LATE, *TURN))
            turn = from_vector(judged.extras[0, list(TURN)]) @ turn
        written = from_rpy(np.round(np.array(to_rpy(turn)) / STEPS[-1]) * STEPS[-1])
        mistakes = [Mistake("plate_order", (), order)] * (order != AS_READ)
        mistakes += [Mistake("units", (), units)] * (units != frame.units)
        found = []
        for each in (turn, written) if np.linalg.norm(turn - written) < SNAPPED else (turn,):
            found += self._of_plate([(*mistakes, turned(each))], [frame.map(each, units, order)])
        return found


@dataclass(frozen=True, eq=False)
class Choice:
    """Which columns are which joint's torques.

    Attributes:
        mistakes: Order, senses and sizes.
        cost: Without these mistakes [nats].
        gain: By how much it is less than with them [nats].
        left: Part of each joint's torque that is not explained, (n,).
        unchanged: The same with the mistakes, (n,).
        sizes: Times what the masses make that torques are; nan where they do not tell, (n,).
    """

    mistakes: tuple[Mistake, ...]
    cost: float
    gain: float
    left: Array
    unchanged: Array
    sizes: Array

    def undoing_nothing(self) -> Choice:
        """Columns as they were recorded."""
        return replace(self, mistakes=(), cost=self.cost + self.gain, gain=0.0, left=self.unchanged)


NO_TORQUES = Choice((), 0.0, 0.0, np.zeros(0), np.zeros(0), np.zeros(0))


def chosen(tree: Tree, torques: TorqueEvidence | None) -> Choice:
    """Order, senses and sizes of recorded torques.

    Args:
        tree: The robot.
        torques: Their evidence, if they were measured.
    """
    if torques is None:
        return NO_TORQUES
    from scipy.optimize import linear_sum_assignment

    order, several = np.arange(tree.n), range(tree.n)
    pairs = {(k, k): least(torques, k, k) for k in several}
    if tree.n <= MOST_JOINTS:
        for j, k in ((j, k) for j in several for k in several if j != k):
            if tree.joints[j].kind == tree.joints[k].kind:
                pairs[j, k] = least(torques, j, k)
        costs = np.full((tree.n, tree.n), 1e9)
        for pair, found in pairs.items():
            costs[pair] = found[0]
        better = linear_sum_assignment(costs)[1]
        if costs[order, better].sum() < costs[order, order].sum() - ORDER:
            order = better
    columns: list[int] = order.tolist()
    best = [pairs[j, k] for j, k in enumerate(columns)]
    moved = tuple(k for k, place in enumerate(columns) if place != k)
    turned_over = tuple(k for k, (_, sense, _) in enumerate(best) if sense < 0)
    odd = tuple(k for k, (_, _, gain) in enumerate(best) if gain != 1.0)
    mistakes = [Mistake("torque_order", moved, tuple(columns))] if moved else []
    mistakes += [Mistake("torque_sign", turned_over)] if turned_over else []
    mistakes += [Mistake("torque_size", odd, tuple(best[k][2] for k in odd))] if odd else []
    cost = sum(each[0] for each in best)
    given = -sum(float(torques.log(k, k)[0]) for k in several)
    return Choice(
        tuple(mistakes),
        cost,
        given - cost,
        np.array([torques.left(j, k, *best[j][1:]) for j, k in enumerate(columns)]),
        np.array([torques.left(k, k, 1.0) for k in several]),
        _positive([torques.size(j, k) * best[j][1] for j, k in enumerate(columns)]),
    )


def _positive(sizes: Sequence[float]) -> Array:
    """Sizes; nan where one is none."""
    return np.array([size if size > 0 else np.nan for size in sizes])


def least(torques: TorqueEvidence, joint: int, column: int) -> tuple[float, float, float]:
    """Least cost, sense and gain with which a column is a joint's torques.

    Args:
        torques: Their evidence.
        joint: Of the robot.
        column: Of the recording.
    """
    logs = torques.log(joint, column)
    found = min((-logs[0], 1.0, 1.0), (SIGN - logs[1], -1.0, 1.0))
    size = abs(torques.size(joint, column))
    if size > LARGE or size < 1 / LARGE:
        logs = torques.log(joint, column, size)
        found = min(found, (GAIN - logs[0], 1.0, size), (GAIN + SIGN - logs[1], -1.0, size))
    return found


def ranked(found: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the best first: of those that explain about as much the simplest."""
    several = list(found)
    best = min(each.price for each in several)
    near = [each for each in several if each.price < best + TOLERANCE]
    far = [each for each in several if each.price >= best + TOLERANCE]
    return sorted(near, key=lambda e: e.rank) + sorted(far, key=lambda e: e.price)
