"""Which mistakes explain a recording: readings of its positions, from the simple to the rare."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import minimal_set
from testbed.robot.free_base import FREE, coordinates, poses
from testbed.robot.tree import Tree
from testbed.sanity.explanation import SIGMAS, Explanation, ranked
from testbed.sanity.instants import LATE, Instants, instants
from testbed.sanity.mistakes import (
    Frame,
    Mistake,
    joint_map,
    position_hypotheses,
    rarer_hypotheses,
)
from testbed.sanity.position_reading import EXPLAINED, Prior, Reading
from testbed.sanity.torque_evidence import prior_root

Progress = Callable[[int, int], None]

Signals = tuple[Array, Array | None, Array | None]
"""Position, torque, wrench."""

DOUBTED = 10.0
"""Gain of a single mistake below which no others are looked for where there is no plate [nats]."""

GOOD = 0.3
"""Share of a torque above which rarer mistakes are looked for where there is no plate."""

MUCH = 20.0
"""Times more than the least that some map of a plate leaves of another reading: it is none."""

READ = 4
"""Readings whose plates are judged; the others cannot come up to them."""

SAID = 6
"""Explanations that are kept, the best first."""

AFRESH = ("late", "quaternion_order")
"""Mistakes without which a recording's instants are others."""

UNITS = ("degrees", "radians", "base_unit", "quaternion_order")
"""Mistakes that concern all joints, which are looked at before those of some."""


class Search:
    """All readings of a recording that were looked at."""

    def __init__(
        self, tree: Tree, signals: Signals, rate: float, offset: Array, frame: Frame,
        progress: Progress | None = None,
    ) -> None:  # fmt: skip
        """Nothing yet.

        Args:
            tree: The robot, its masses roughly right.
            signals: Position (M, n), torque (M, n), wrench (M, 6); the last two if measured.
            rate: Samples a second [Hz].
            offset: What the mapping has added to the positions, (n,).
            frame: How the mapping has read the plate.
            progress: Told how many readings are done, and of how many.
        """
        self.tree, self.progress = tree, progress
        self._signals, self._rate, self._offset = signals, rate, offset
        self._theta = np.eye(10 * tree.n).reshape(tree.n, 10, 10 * tree.n)
        told = minimal_set(tree, "reaction").lift
        self.prior = Prior(tree, frame, barycentric(tree).ravel(), prior_root(tree), told)
        self.readings: dict[tuple[Mistake, ...], Reading] = {}
        self.given = instants(*signals, rate)
        self.plate = signals[2] is not None

    def read(self, mistakes: tuple[Mistake, ...], taken: Instants) -> Reading:
        """A reading, made once."""
        if mistakes not in self.readings:
            time = np.arange(len(taken.position), dtype=np.float64) * taken.spacing
            motion = Motion(time, taken.position, taken.velocity, taken.acceleration)
            joints, base = linear(self.tree, motion, self._theta)
            self.readings[mistakes] = Reading(self.prior, mistakes, taken, joints, base)
        return self.readings[mistakes]

    def without(self, beside: Reading, mistake: Mistake) -> Reading | None:
        """A reading with one mistake less about positions or clocks; None where it is no motion."""
        mistakes = (*beside.mistakes, mistake)
        if mistake.kind in AFRESH:
            taken = self._afresh(mistakes)
        else:
            taken = beside.taken.moved(*joint_map(mistake, self.tree.n, self._offset))
        return None if taken is None else self.read(mistakes, taken)

    def _afresh(self, mistakes: tuple[Mistake, ...]) -> Instants | None:
        """Instants without mistakes that change what is read when, or how a base stands."""
        (position, *others), late = self._signals, 0.0
        for each in mistakes:
            if each.kind == "late":
                late += each.values[0]
            if each.kind == "quaternion_order":
                pose = poses(position[:, :FREE])
                pose[:, 3:] = pose[:, 3:][:, list(each.values)]
                try:
                    position = np.hstack([coordinates(pose), position[:, FREE:]])
                except RecordingError:  # the base would stand on its head
                    return None
        taken = instants(position, others[0], others[1], self._rate, late)
        for each in mistakes:
            if taken is not None and each.kind not in AFRESH:
                taken = taken.moved(*joint_map(each, self.tree.n, self._offset))
        return taken

    def best(self) -> tuple[Explanation, list[Explanation]]:
        """The recording as it is, and what explains it, the best first."""
        assert self.given is not None
        given = self.read((), self.given)
        as_read = given.as_read()
        as_given = as_read.told(changed=False)
        if given.fine(as_read):
            return as_given, [as_given]
        found = ranked(self._found(given, as_read))
        nearest = found[0].reading
        if self.plate and nearest.moved:
            found = ranked([*found, *self._refined(nearest).explanations])
        several = list({each.mistakes: each for each in found[::-1]}.values())[::-1]
        return as_given, ranked(each.told() for each in several[:SAID])

    def _found(self, given: Reading, best: Explanation) -> list[Explanation]:
        """What may explain it; no more once all is explained."""
        several = [best]
        for found in self._stages(given, several):
            several += found
            likeliest = min(several, key=lambda each: each.cost)
            if self.plate and likeliest.explained(EXPLAINED):
                told = likeliest.told()
                if not told.odd_torques(SIGMAS):
                    several += self._with_signs(told)
                    break
        return several

    def _with_signs(self, told: Explanation) -> list[Explanation]:
        """What explains it with other senses of the positions whose torques are unclear."""
        beside = told.reading
        known = {joint for each in beside.mistakes for joint in each.joints
                 if each.kind == "position_sign"}  # fmt: skip
        signs = [Mistake("position_sign", (joint,)) for joint in sorted(told.unclear - known)]
        found = (self.without(beside, each) for each in signs)
        return [each for reading in found if reading is not None for each in reading.explanations]

    def _stages(self, given: Reading, several: list[Explanation]) -> Iterator[list[Explanation]]:
        """Explanations from the simple to the rare.

        Args:
            given: The positions as they were read.
            several: All that was found before.
        """
        hypotheses = list(position_hypotheses(self.tree, given.taken.position, ()))
        yield given.explanations
        units = [each for each in hypotheses if each.kind in UNITS]
        self._look(given, units)
        if units:  # without them the readings are those that were judged
            yield self._judged()
        explained = any(each.explained(EXPLAINED) for each in several)
        in_time = None if explained else self._in_time(given)
        if in_time is None:
            self._look(given, hypotheses)
            in_time = None if explained else self._in_time(given)
        if in_time is not None:
            yield from self._stages(in_time, several)
            return
        if not self.plate:
            yield self._judged()
            plain = [each.cost for each in several if not each.sized]
            if several[0].sized and min(plain, default=np.inf) > several[0].cost - DOUBTED:
                del several[1:]  # torques of another size leave little to tell of the rest
                return
            yield self._at_best_zeros(2)
            likeliest = min(several, key=lambda each: each.cost)
            gain = several[0].told(changed=False).cost - likeliest.cost
            if gain < DOUBTED or likeliest.explained(GOOD):
                return
        yield self._judged()
        likeliest = min(several, key=lambda each: each.cost)
        if self.plate and given.mixed(likeliest.left[-6:]):
            return  # positions are right where only a matrix explains the plate
        self._look(given, rarer_hypotheses(self.tree, pairs=not self.plate))
        yield self._at_best_zeros(3)
        for each in self._nearest(2 if self.plate else 4):
            self._look(each, position_hypotheses(self.tree, each.taken.position, each.mistakes))
        yield self._judged()

    def _in_time(self, given: Reading) -> Reading | None:
        """The same with the plate's clock set, where a reading shows that it is late, or early."""
        late, times = min((each.delay for each in self.readings.values()), key=lambda d: d[1])
        if times > LATE or given.mistakes:
            return None
        return self.without(given, Mistake("late", (), (late,)))

    def _look(self, beside: Reading, hypotheses: Iterable[Mistake]) -> None:
        several = list(hypotheses)
        for done, each in enumerate(several, 1):
            self.without(beside, each)
            if self.progress is not None:
                self.progress(done, len(several))

    def _nearest(self, count: int) -> list[Reading]:
        return sorted(self.readings.values(), key=lambda each: each.bound)[:count]

    def _judged(self) -> list[Explanation]:
        """What the readings leave that may be the best."""
        return list(chain.from_iterable(each.explanations for each in self._promising()))

    def _promising(self) -> list[Reading]:
        """The nearest readings, but for those that no map of a plate could explain as well."""
        nearest = self._nearest(READ)
        least = MUCH * min((each.least for each in nearest), default=0.0) + EXPLAINED
        return [each for each in nearest if each.least <= least]

    def _at_best_zeros(self, count: int) -> list[Explanation]:
        zeros = [self._refined(each) for each in self._nearest(count) if each.moved]
        return list(chain.from_iterable(each.explanations for each in zeros))

    def _refined(self, reading: Reading) -> Reading:
        """A reading whose last zero is the best angle, not one that was tried."""
        *before, last = reading.mistakes
        for step in np.deg2rad([12, -12, 6, -6, 3, -3, 1.5, -1.5, 0.7, -0.7]):
            nearer = True
            while nearer:
                scale, added = np.eye(self.tree.n), np.zeros(self.tree.n)
                added[list(last.joints)] = step
                moved = replace(last, values=tuple(round(angle + step, 6) for angle in last.values))
                tried = self.read((*before, moved), reading.taken.moved(scale, added))
                nearer = tried.misfit < reading.misfit
                if nearer:
                    reading, last = tried, moved
        return reading
