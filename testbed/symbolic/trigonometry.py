"""Products of cosines and sines in one normal form.

Angles fall into groups, such as the joints whose axes are parallel. Of each group a wave has
at most one cosine or sine, of a sum of angles with numbers: products within a group become
sums, 2 cos a cos b = cos(a - b) + cos(a + b). Waves that differ are linearly independent,
so equal expressions come out alike. Sums across groups are expanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product as choices
from math import prod
from typing import TypeAlias

from testbed.symbolic.budget import Budget
from testbed.symbolic.expression import Number

Index: TypeAlias = tuple[tuple[int, Number], ...]  # (angle, how many times), in order
Tone: TypeAlias = tuple[int, int, Index]  # group, 0 for a cosine or 1 for a sine, its angle
Wave: TypeAlias = tuple[Tone, ...]  # at most one tone a group, in order
Mixture: TypeAlias = tuple[tuple[int, float], ...]  # (number of a wave, its weight)

COSINE, SINE = 0, 1


class Waves:
    """Every wave met so far by number, and the products of any two.

    Attributes:
        list: The waves; number 0 is 1.
        group: The group of an angle, by its number; angles that are not there are alone.
    """

    def __init__(self, group: dict[int, int], budget: Budget) -> None:
        """No waves but 1.

        Args:
            group: Angles that are together, by angle.
            budget: Counts what is multiplied.
        """
        self._budget = budget
        self.list: list[Wave] = [()]
        self.group = group
        self._number: dict[Wave, int] = {(): 0}
        self._products: dict[tuple[int, int], Mixture] = {}

    def number(self, wave: Wave) -> int:
        """The number of a wave."""
        found = self._number.get(wave)
        if found is None:
            found = self._number[wave] = len(self.list)
            self.list.append(wave)
        return found

    def tone(self, kind: int, angle: Sequence[tuple[int, Number]]) -> Mixture:
        """Cosine or sine of a sum of angles, as a mixture of waves."""
        parts: dict[int, list[tuple[int, Number]]] = {}
        for atom, times in sorted(angle):
            parts.setdefault(self.group.get(atom, -1 - atom), []).append((atom, times))
        cosines: dict[int, float] = {0: 1.0}
        sines: dict[int, float] = {}
        for group, part in parts.items():  # cos(a + b) and sin(a + b)
            c, s = self._single(group, COSINE, tuple(part)), self._single(group, SINE, tuple(part))
            cosines, sines = (
                self._added(self._times(cosines, c), self._times(sines, s), -1.0),
                self._added(self._times(sines, c), self._times(cosines, s), 1.0),
            )
        return tuple((sines if kind else cosines).items())

    def product(self, a: int, b: int) -> Mixture:
        """Two waves multiplied."""
        if a == 0 or b == 0:
            return ((a or b, 1.0),)
        key = (a, b) if a < b else (b, a)
        found = self._products.get(key)
        if found is None:
            found = self._products[key] = self._multiplied(self.list[a], self.list[b])
        return found

    def _multiplied(self, a: Wave, b: Wave) -> Mixture:
        left, right = {tone[0]: tone for tone in a}, {tone[0]: tone for tone in b}
        options: list[list[tuple[Wave, float]]] = []
        for group in sorted({*left, *right}):
            one, two = left.get(group), right.get(group)
            if one and two:
                options.append(_in_group(group, one, two))
            else:
                options.append([((one or two or _NEVER,), 1.0)])
        self._budget.multiply(prod(len(each) for each in options))
        mixture: dict[int, float] = {}
        for choice in choices(*options):
            weight = 1.0
            for _, share in choice:
                weight *= share
            if weight:
                wave = self.number(tuple(tone for tones, _ in choice for tone in tones))
                mixture[wave] = mixture.get(wave, 0.0) + weight
        return tuple((wave, weight) for wave, weight in mixture.items() if weight)

    def _single(self, group: int, kind: int, index: Index) -> dict[int, float]:
        sign, wave = _normal(group, kind, index)
        return {self.number(wave): sign} if sign else {}

    def _times(self, a: dict[int, float], b: dict[int, float]) -> dict[int, float]:
        result: dict[int, float] = {}
        for x, u in a.items():
            for y, v in b.items():
                for wave, weight in self.product(x, y):
                    result[wave] = result.get(wave, 0.0) + u * v * weight
        return result

    def _added(self, a: dict[int, float], b: dict[int, float], sign: float) -> dict[int, float]:
        result = dict(a)
        for wave, weight in b.items():
            result[wave] = result.get(wave, 0.0) + sign * weight
        return {wave: weight for wave, weight in result.items() if weight}


_NEVER: Tone = (0, 0, ())


def _in_group(group: int, one: Tone, two: Tone) -> list[tuple[Wave, float]]:
    """The product of two tones of one group as a sum of two."""
    difference, total = combined(one[2], two[2], -1), combined(one[2], two[2], 1)
    kinds = (one[1], two[1])
    if kinds == (COSINE, COSINE):
        parts = [(COSINE, difference, 0.5), (COSINE, total, 0.5)]
    elif kinds == (SINE, SINE):
        parts = [(COSINE, difference, 0.5), (COSINE, total, -0.5)]
    else:  # sin a cos b = (sin(a + b) + sin(a - b)) / 2
        parts = [(SINE, total, 0.5), (SINE, difference, 0.5 if kinds == (SINE, COSINE) else -0.5)]
    options = []
    for kind, index, weight in parts:
        sign, wave = _normal(group, kind, index)
        options.append((wave, sign * weight))
    return options


def combined(a: Index, b: Index, sign: int) -> Index:
    """The sum or difference of two angles."""
    total = dict(a)
    for atom, times in b:
        total[atom] = total.get(atom, 0) + sign * times
    return tuple(sorted((atom, times) for atom, times in total.items() if times))


def _normal(group: int, kind: int, index: Index) -> tuple[float, Wave]:
    """Sign and wave of a tone: the first angle counts positively; cos 0 = 1, sin 0 = 0."""
    if not index:
        return (0.0 if kind == SINE else 1.0), ()
    if index[0][1] > 0:
        return 1.0, ((group, kind, index),)
    turned = tuple((atom, -times) for atom, times in index)
    return (-1.0 if kind == SINE else 1.0), ((group, kind, turned),)
