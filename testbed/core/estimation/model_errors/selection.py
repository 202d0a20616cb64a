"""Forward selection of families of model errors, the noise estimated anew beside each set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.held_out_rows import predictive
from testbed.core.estimation.model_errors.restricted_likelihood import (
    ProjectedRows,
    RegressionRows,
    RowNoise,
    Solution,
)

ALARM = 15.0
"""Least gain of a family [nats]."""

SURE = 50.0
"""Least gain of a family that is named, and corrected [nats]."""

SURE_BESIDE_FILE = 100.0
"""The same for recordings of real robots: what is left there is no noise, and gains are larger."""

MOST = 4
"""Families of one recording."""

PREFERENCE = 0.6
"""Part of an unknown family's gain with which a physical one is preferred."""

NEARLY = 0.85
"""Part of the largest gain with which a family of fewer columns is preferred."""

ROUNDS = 3
"""Times that noise and variances are estimated in turn."""

NOISY = 40.0
"""Gain of noisy families that noise of the encoders may make [nats]."""

FEWEST = 4.0
"""Rows an unknown below which nothing is looked for."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Families that make the measurements likelier.

    Attributes:
        products: Of unknowns and chosen families, under the noise of the estimate.
        variances: By kind, in squares of plausible sizes.
        gains: Log likelihood that each is worth, all else estimated anew without it, by kind.
        plain: Of the unknowns alone.
        taken: Kinds of families to be taken out of the measurements: they are sure, follow from
            laws, last, are no terms, and predict held-out rows.
    """

    products: ProjectedRows
    variances: Mapping[str, float]
    gains: Mapping[str, float]
    plain: ProjectedRows
    taken: tuple[str, ...]

    @property
    def solution(self) -> Solution:
        """Unknowns and coefficients."""
        return self.products.solve(self.variances)


@dataclass(frozen=True, eq=False)
class _Model:
    """A set of families with noise and variances of their own.

    Attributes:
        products: Of unknowns and families.
        variances: By kind.
        score: Log likelihood, less what the choice among alternatives costs.
    """

    products: ProjectedRows
    variances: Mapping[str, float] = field(default_factory=dict)
    score: float = 0.0


class Selector:
    """Rows, families, and the models that were fitted."""

    def __init__(
        self,
        rows: RegressionRows,
        families: Sequence[ModelErrorFamily],
        encoder_share: Callable[[Array], float],
    ) -> None:
        """Fit the unknowns alone.

        Args:
            rows: Of unknowns, measurements and all families.
            families: Which.
            encoder_share: Part of residuals, of mean squares (C,), that is the encoders' noise.
        """
        self._rows, self._physical = rows, {f.kind for f in families if f.physical}
        self._correctable = {
            f.kind for f in families if f.physical and f.lasting and not f.is_term
        }
        self._costs = dict.fromkeys(rows.families, 0.0)
        noise = self._plain_noise()
        self._plain = _scored(ProjectedRows(rows, (), noise), {}, 0.0)
        share = min(encoder_share(noise.total**2), 1.0)
        for family in families:
            self._costs[family.kind] += NOISY * share * family.noisy
            if family.alternatives > 1:
                pairs = rows.families[family.kind].shape[2] // 2
                self._costs[family.kind] += pairs * float(np.log(family.alternatives))

    def _plain_noise(self) -> RowNoise:
        """Noise of what the unknowns alone leave."""
        rows = self._rows
        noise = _white(rows.noise(rows.measured, 0.0))
        for _ in range(ROUNDS + 1):
            noise = self._noise_beside(ProjectedRows(rows, (), noise), {})
        return noise

    def _noise_beside(
        self, products: ProjectedRows, chosen: Mapping[str, float]
    ) -> RowNoise:
        """Noise of what unknowns and families leave."""
        rows, solution = self._rows, products.solve(chosen)
        unknowns, more = np.split(solution.values, [products.p])
        residual = rows.measured - rows.columns @ unknowns
        if len(more):
            blocks = [rows.families[kind] for kind in chosen]
            residual = residual - np.concatenate(blocks, axis=2) @ more
        return rows.noise(residual * rows.used, solution.freedom)

    def select(self) -> Selection:
        """Families in the order of their gains, chosen forward from two starts."""
        rows, plain = self._rows, self._plain
        best = plain
        if rows.used.sum() >= FEWEST * rows.columns.shape[2]:
            noise, wide = plain.products.noise, self._wide_noise()
            first = self._forward(noise, tuple(rows.families), {}, MOST)
            second = self._forward(wide, self._known, {}, 2)
            best = max(best, self._settled(first, noise), key=_score)
            if set(second) - set(first):
                best = max(best, self._settled(second, wide), key=_score)
            if best.variances:
                noise = best.products.noise
                more = self._forward(noise, tuple(rows.families), best.variances, MOST)
                if set(more) != set(best.variances):
                    best = max(best, self._settled(more, noise), key=_score)
        best, gains = self._pruned(best)
        if len(rows.prior) and best.variances:
            best = self._weighted(best)
        return Selection(
            best.products,
            best.variances,
            gains,
            plain.products,
            self._taken(best, gains),
        )

    def _taken(self, model: _Model, gains: Mapping[str, float]) -> tuple[str, ...]:
        """Families that predict held-out rows, of those that are sure, physical and lasting."""
        sure = SURE_BESIDE_FILE if len(self._rows.prior) else SURE
        order = [k for k, g in gains.items() if g >= sure and k in self._correctable]
        if not order:
            return ()
        kinds, noise = tuple(model.variances), _white(model.products.noise)
        products = ProjectedRows(self._rows, kinds, noise)
        variances = np.array([model.variances[kind] for kind in order])
        return tuple(order[: predictive(products, order, variances)])

    def _weighted(self, model: _Model) -> _Model:
        """The same families under white noise of each channel's size.

        Estimates with a prior weigh rows so: where model errors are larger than noise, whitening
        makes much of what no model explains.
        """
        noise = _white(model.products.noise)
        products = ProjectedRows(self._rows, tuple(model.variances), noise)
        return replace(model, products=products)

    @property
    def _known(self) -> tuple[str, ...]:
        """Kinds that follow from laws."""
        return tuple(kind for kind in self._rows.families if kind in self._physical)

    def _wide_noise(self) -> RowNoise:
        """Noise of what is left beside all physical families of plausible sizes.

        The noise of the plain fit has swallowed slow errors; this one is too white.
        """
        plain = self._plain.products.noise
        white = _white(plain)
        every = dict.fromkeys(self._known, 1.0)
        return self._noise_beside(ProjectedRows(self._rows, self._known, white), every)

    def _forward(
        self,
        noise: RowNoise,
        among: Sequence[str],
        start: Mapping[str, float],
        most: int,
    ) -> dict[str, float]:
        """Families chosen one by one under a given noise, with their variances."""
        products = ProjectedRows(self._rows, among, noise)
        chosen = products.tuned(start, 2)
        while len(chosen) < most:
            gains = {
                kind: products.gain(kind, chosen)
                for kind in among
                if kind not in chosen
            }
            scores = {
                kind: gain - self._costs[kind] for kind, (gain, _) in gains.items()
            }
            if not scores:
                break
            kind = self._preferred(scores)
            if scores[kind] < ALARM:
                break
            chosen = products.tuned({**chosen, kind: gains[kind][1]}, 2)
            if kind not in chosen:
                break
        return chosen

    def _preferred(self, scores: Mapping[str, float]) -> str:
        """Family of the largest gain; a physical or smaller one if it is nearly as good."""
        best = max(scores.values())
        known = {k: v for k, v in scores.items() if k in self._physical}
        if not known or max(known.values()) <= PREFERENCE * best:
            return max(scores, key=lambda kind: scores[kind])
        least = NEARLY * max(known.values())
        columns = {
            k: self._rows.families[k].shape[2] for k, v in known.items() if v >= least
        }
        return min(columns, key=lambda kind: (columns[kind], -known[kind]))

    def _settled(self, chosen: Mapping[str, float], noise: RowNoise) -> _Model:
        """Noise and variances of a set, estimated in turn."""
        kinds, variances = tuple(chosen), dict(chosen)
        for _ in range(ROUNDS):
            products = ProjectedRows(self._rows, kinds, noise)
            variances = products.tuned(variances, 1)
            noise = self._noise_beside(products, variances)
        kinds = tuple(variances)
        cost = sum(self._costs[kind] for kind in kinds)
        return _scored(ProjectedRows(self._rows, kinds, noise), variances, cost)

    def _pruned(self, model: _Model) -> tuple[_Model, dict[str, float]]:
        """Families without which the likelihood falls by less than ALARM are left out."""
        while model.variances:
            gains = {}
            for kind in model.variances:
                rest = {k: v for k, v in model.variances.items() if k != kind}
                without = self._plain
                if rest:
                    without = self._settled(rest, model.products.noise)
                gains[kind] = model.score - without.score
            worst = min(gains, key=lambda kind: gains[kind])
            if gains[worst] >= ALARM:
                ordered = sorted(gains.items(), key=lambda item: -item[1])
                return model, dict(ordered)
            rest = {k: v for k, v in model.variances.items() if k != worst}
            model = self._settled(rest, model.products.noise) if rest else self._plain
        return self._plain, {}


def _white(noise: RowNoise) -> RowNoise:
    """White noise of the same size."""
    process = replace(
        noise.process,
        coefficients=np.zeros_like(noise.process.coefficients),
        sigma=noise.total,
    )
    return noise._replace(process=process)


def _score(model: _Model) -> float:
    return model.score


def _scored(
    products: ProjectedRows, variances: Mapping[str, float], cost: float
) -> _Model:
    """Model with its log likelihood."""
    return _Model(products, variances, products.likelihood(variances) - cost)
