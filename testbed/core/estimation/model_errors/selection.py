"""Forward selection of model error families, with the noise estimated for each set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.held_out_rows import predictive_count
from testbed.core.estimation.model_errors.restricted_likelihood import (
    ProjectedRows,
    RegressionRows,
    RowNoise,
    Solution,
)

MIN_GAIN = 15.0
"""Smallest gain of a selected family [nats]."""

MIN_NAMED_GAIN = 50.0
"""Smallest gain of a family that is named as the cause, and corrected [nats]."""

MIN_NAMED_GAIN_WITH_PRIOR = 100.0
"""Smallest gain of a corrected family if there is a prior, as for real robots [nats]: their
residuals are no noise, and gains are larger."""

MAX_FAMILIES = 4
"""Largest number of families of one recording."""

PHYSICAL_PREFERENCE = 0.6
"""Part of an unknown family's gain above which a physical family is preferred."""

FEWER_COLUMNS_PREFERENCE = 0.85
"""Part of the largest gain above which a family with fewer columns is preferred."""

NOISE_ITERATIONS = 3
"""Number of alternations between noise and variances."""

MAX_ENCODER_GAIN = 40.0
"""Largest gain that encoder noise causes in families with noisy columns [nats]."""

MIN_ROWS_PER_UNKNOWN = 4.0
"""Smallest number of rows per unknown for a selection."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Selected families of model errors, which increase the likelihood of the measurements.

    Attributes:
        products: Projected rows of unknowns and chosen families, under the estimate's noise.
        variances: Variances keyed by kind, in squares of plausible sizes.
        gains: Gain of the log likelihood due to each kind, relative to a new fit without it [nats].
        plain: Projected rows of the unknowns alone.
        taken: Kinds of families to be subtracted from the measurements. They are significant,
            physical, lasting and predictive of held-out rows, and no joint terms.
    """

    products: ProjectedRows
    variances: Mapping[str, float]
    gains: Mapping[str, float]
    plain: ProjectedRows
    taken: tuple[str, ...]

    @property
    def solution(self) -> Solution:
        """Estimates of unknowns and coefficients of the selected families."""
        return self.products.solve(self.variances)


@dataclass(frozen=True, eq=False)
class _Model:
    """Set of families with the noise and variances estimated for it.

    Attributes:
        products: Projected rows of unknowns and families.
        variances: Variances of families, keyed by kind.
        score: Log likelihood minus the costs of the families.
    """

    products: ProjectedRows
    variances: Mapping[str, float] = field(default_factory=dict)
    score: float = 0.0


class Selector:
    """Forward selection of families by restricted likelihood.

    The score of a model is its log likelihood minus the costs of its families.
    """

    def __init__(
        self,
        rows: RegressionRows,
        families: Sequence[ModelErrorFamily],
        encoder_share: Callable[[Array], float],
    ) -> None:
        """Fit the unknowns without families, and set the cost of each family.

        The cost is MAX_ENCODER_GAIN times the share of encoder noise in the residuals, if the
        family's columns are noisy, plus the logarithm of the number of alternatives for each chosen
        pair of columns.

        Args:
            rows: Rows of unknowns, measurements and all families.
            families: Families to select from.
            encoder_share: Function that returns the share of encoder noise in mean squared
                residuals, (C,).
        """
        self._rows, self._physical = rows, {f.kind for f in families if f.physical}
        self._correctable = {
            f.kind for f in families if f.physical and f.lasting and not f.is_term
        }
        self._costs = dict.fromkeys(rows.families, 0.0)
        noise = self._plain_noise()
        self._plain = _scored_model(ProjectedRows(rows, (), noise), {}, 0.0)
        share = min(encoder_share(noise.total**2), 1.0)
        for family in families:
            self._costs[family.kind] += MAX_ENCODER_GAIN * share * family.noisy
            if family.alternatives > 1:
                pairs = rows.families[family.kind].shape[2] // 2
                self._costs[family.kind] += pairs * float(np.log(family.alternatives))

    def _plain_noise(self) -> RowNoise:
        """Noise of the residuals of a fit without families, iterated from white noise."""
        rows = self._rows
        noise = _white_noise(rows.fit_noise(rows.measured, 0.0))
        for _ in range(NOISE_ITERATIONS + 1):
            noise = self._residual_noise(ProjectedRows(rows, (), noise), {})
        return noise

    def _residual_noise(
        self, products: ProjectedRows, chosen: Mapping[str, float]
    ) -> RowNoise:
        """Noise of the residuals of a fit of the unknowns and chosen families.

        Args:
            products: Projected rows.
            chosen: Variances of families, keyed by kind.
        """
        rows, solution = self._rows, products.solve(chosen)
        unknowns, coefficients = np.split(solution.values, [products.p])
        residual = rows.measured - rows.columns @ unknowns
        if len(coefficients):
            blocks = [rows.families[kind] for kind in chosen]
            residual = residual - np.concatenate(blocks, axis=2) @ coefficients
        return rows.fit_noise(residual * rows.row_mask, solution.freedom)

    def select(self) -> Selection:
        """Select families by forward selection under two noise models, then prune.

        The noise models are that of the fit without families, and `_wide_noise` for up to two
        physical families. The model with the larger score is extended under its own noise; then
        families with a gain below MIN_GAIN are removed. If there is a prior, the noise is finally
        taken as white. No family is selected if there are fewer than MIN_ROWS_PER_UNKNOWN rows per
        unknown.
        """
        rows, plain = self._rows, self._plain
        best = plain
        if rows.row_mask.sum() >= MIN_ROWS_PER_UNKNOWN * rows.columns.shape[2]:
            noise, wide_noise = plain.products.noise, self._wide_noise()
            from_plain = self._forward(noise, tuple(rows.families), {}, MAX_FAMILIES)
            from_wide = self._forward(wide_noise, self._physical_kinds, {}, 2)
            best = max(best, self._fitted_model(from_plain, noise), key=_score)
            if set(from_wide) - set(from_plain):
                best = max(best, self._fitted_model(from_wide, wide_noise), key=_score)
            if best.variances:
                noise = best.products.noise
                extended = self._forward(
                    noise, tuple(rows.families), best.variances, MAX_FAMILIES
                )
                if set(extended) != set(best.variances):
                    best = max(best, self._fitted_model(extended, noise), key=_score)
        best, gains = self._pruned_model(best)
        if len(rows.prior) and best.variances:
            best = self._white_model(best)
        return Selection(
            best.products,
            best.variances,
            gains,
            plain.products,
            self._corrected_kinds(best, gains),
        )

    def _corrected_kinds(
        self, model: _Model, gains: Mapping[str, float]
    ) -> tuple[str, ...]:
        """Kinds to be corrected: predictive of held-out rows, significant, physical and lasting.

        Significant gains are at least MIN_NAMED_GAIN or, with a prior, MIN_NAMED_GAIN_WITH_PRIOR.
        Joint terms are not corrected.

        Args:
            model: Selected model.
            gains: Gains keyed by kind, in decreasing order.
        """
        min_gain = (
            MIN_NAMED_GAIN_WITH_PRIOR if len(self._rows.prior) else MIN_NAMED_GAIN
        )
        order = [
            k for k, g in gains.items() if g >= min_gain and k in self._correctable
        ]
        if not order:
            return ()
        kinds, noise = tuple(model.variances), _white_noise(model.products.noise)
        products = ProjectedRows(self._rows, kinds, noise)
        variances = np.array([model.variances[kind] for kind in order])
        return tuple(order[: predictive_count(products, order, variances)])

    def _white_model(self, model: _Model) -> _Model:
        """Model with the same families under white noise in each channel.

        Rows are weighted in this way if there is a prior: where model errors are larger than the
        noise, whitening amplifies unexplained parts.
        """
        noise = _white_noise(model.products.noise)
        products = ProjectedRows(self._rows, tuple(model.variances), noise)
        return replace(model, products=products)

    @property
    def _physical_kinds(self) -> tuple[str, ...]:
        """Kinds of the physical families."""
        return tuple(kind for kind in self._rows.families if kind in self._physical)

    def _wide_noise(self) -> RowNoise:
        """Noise of the residuals of a fit with all physical families of plausible sizes.

        The noise of the fit without families contains slow model errors; the noise computed here
        is, in contrast, too white.
        """
        plain = self._plain.products.noise
        white = _white_noise(plain)
        variances = dict.fromkeys(self._physical_kinds, 1.0)
        return self._residual_noise(
            ProjectedRows(self._rows, self._physical_kinds, white), variances
        )

    def _forward(
        self,
        noise: RowNoise,
        candidates: Sequence[str],
        start: Mapping[str, float],
        max_families: int,
    ) -> dict[str, float]:
        """Variances of families selected one by one under a given noise.

        Each step adds the family of `_preferred_kind` and tunes all variances. The selection ends
        if the score of that family, `gain - cost`, is below MIN_GAIN.

        Args:
            noise: Noise of the rows.
            candidates: Kinds to select from.
            start: Variances of previously selected families, keyed by kind.
            max_families: Largest number of families.
        """
        products = ProjectedRows(self._rows, candidates, noise)
        chosen = products.tuned_variances(start, 2)
        while len(chosen) < max_families:
            gains = {
                kind: products.gain(kind, chosen)
                for kind in candidates
                if kind not in chosen
            }
            scores = {
                kind: gain - self._costs[kind] for kind, (gain, _) in gains.items()
            }
            if not scores:
                break
            kind = self._preferred_kind(scores)
            if scores[kind] < MIN_GAIN:
                break
            chosen = products.tuned_variances({**chosen, kind: gains[kind][1]}, 2)
            if kind not in chosen:
                break
        return chosen

    def _preferred_kind(self, scores: Mapping[str, float]) -> str:
        """Kind with the largest score; a physical or smaller family if nearly as good.

        The kind with the largest score is chosen unless a physical family has more than
        PHYSICAL_PREFERENCE times this score. Of the physical families with at least
        FEWER_COLUMNS_PREFERENCE times their largest score, the one with the fewest columns is then
        chosen.

        Args:
            scores: Scores `gain - cost`, keyed by kind.
        """
        best = max(scores.values())
        physical = {k: v for k, v in scores.items() if k in self._physical}
        if not physical or max(physical.values()) <= PHYSICAL_PREFERENCE * best:
            return max(scores, key=lambda kind: scores[kind])
        min_score = FEWER_COLUMNS_PREFERENCE * max(physical.values())
        columns = {
            k: self._rows.families[k].shape[2]
            for k, v in physical.items()
            if v >= min_score
        }
        return min(columns, key=lambda kind: (columns[kind], -physical[kind]))

    def _fitted_model(self, chosen: Mapping[str, float], noise: RowNoise) -> _Model:
        """Model of a set of families, with noise and variances estimated alternately.

        Families without gain are dropped.

        Args:
            chosen: Initial variances, keyed by kind.
            noise: Initial noise.
        """
        kinds, variances = tuple(chosen), dict(chosen)
        for _ in range(NOISE_ITERATIONS):
            products = ProjectedRows(self._rows, kinds, noise)
            variances = products.tuned_variances(variances, 1)
            noise = self._residual_noise(products, variances)
        kinds = tuple(variances)
        cost = sum(self._costs[kind] for kind in kinds)
        return _scored_model(ProjectedRows(self._rows, kinds, noise), variances, cost)

    def _pruned_model(self, model: _Model) -> tuple[_Model, dict[str, float]]:
        """Model without families whose gain is below MIN_GAIN, and its gains in decreasing order.

        The gain of a family is the loss of score in a fit without it. The family with the smallest
        gain is removed until all gains are at least MIN_GAIN.

        Args:
            model: Model to be pruned.
        """
        while model.variances:
            gains = {}
            for kind in model.variances:
                rest = {k: v for k, v in model.variances.items() if k != kind}
                reduced = self._plain
                if rest:
                    reduced = self._fitted_model(rest, model.products.noise)
                gains[kind] = model.score - reduced.score
            weakest = min(gains, key=lambda kind: gains[kind])
            if gains[weakest] >= MIN_GAIN:
                ordered = sorted(gains.items(), key=lambda item: -item[1])
                return model, dict(ordered)
            rest = {k: v for k, v in model.variances.items() if k != weakest}
            model = (
                self._fitted_model(rest, model.products.noise) if rest else self._plain
            )
        return self._plain, {}


def _white_noise(noise: RowNoise) -> RowNoise:
    """White noise of the same standard deviations."""
    process = replace(
        noise.process,
        coefficients=np.zeros_like(noise.process.coefficients),
        sigma=noise.total,
    )
    return noise._replace(process=process)


def _score(model: _Model) -> float:
    """Score of a model, as a sort key."""
    return model.score


def _scored_model(
    products: ProjectedRows, variances: Mapping[str, float], cost: float
) -> _Model:
    """Model with the penalised log likelihood as score.

    Args:
        products: Projected rows of unknowns and families.
        variances: Variances of families, keyed by kind.
        cost: Penalty on the log likelihood.
    """
    return _Model(products, variances, products.log_likelihood(variances) - cost)
