"""What a model file and estimates leave of data that they have not seen, beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.bodies.row_products import RowProducts, products_of, sum_of
from testbed.core.base.arrays import Array
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnostic, diagnose, phrase
from testbed.core.estimation.estimate import Method, channel_label, channel_units
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.regression.windows import ROWS_PER_CUTOFF
from testbed.core.recordings.source import Source

FILE, REFITTED, PLAIN = "file", "refitted", "plain"
POSTERIOR, CONSISTENT = "posterior", "consistent"
"""The model file as it is; with the plate's zero, or friction and offsets, fitted; least squares;
with the file as prior; consistent bodies."""

WORSE = {REFITTED: 1.05, PLAIN: 1.2}
"""Error over that of a rival that is worth a word: the model file with its friction fitted, least
squares."""

NOTICEABLE = 5e-3
"""Part of its signal by which a channel is worse predicted, in squares, that is of any matter."""

CHANCE = 0.01
"""Of such an error by the scatter of parts alone, below which it is worth one."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """What is left of signals that no fit has seen.

    Attributes:
        method: By plate or by torques.
        of: "like": eighths of the recording, each by all others; "faster": its fast parts by the
            slow ones; "another": another recording.
        channels: The measured channels, (C,).
        units: One each, N or N m.
        rows: How many there are, (C,).
        signal: Rms of the channels, of a plate with an unknown zero about their mean, (C,); it and
            all else is nan where rows are too few.
        residual: Rms of what is left, (C,) [N, N m], by what predicts: "file", "refitted",
            "plain", "posterior", "consistent".
        chance: Of errors so much above those of a rival, "refitted" or "plain", where parts only
            scatter, (C,), by rival and what predicts; for the largest of all channels.
    """

    method: Method
    of: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rows: Array
    signal: Array
    residual: Mapping[str, Array]
    chance: Mapping[str, Mapping[str, Array]]

    __get_pydantic_core_schema__ = with_properties("best")

    @property
    def best(self) -> str:
        """What leaves least."""
        return min(self.residual, key=self.over_file)

    def beside(self, other: PredictionErrors) -> PredictionErrors:
        """The same with what others leave of the same data.

        Args:
            other: By them.
        """
        residual = {**other.residual, **self.residual}
        chance = {
            than: {**other.chance.get(than, {}), **own}
            for than, own in self.chance.items()
        }
        return replace(self, residual=residual, chance=chance)

    def share(self, which: str) -> Array:
        """Rms prediction error over rms signal, (C,); nan where a channel has none.

        Args:
            which: What predicts.
        """
        signal = np.where(self.signal > 0, self.signal, np.nan)
        return self.residual[which] / signal

    def over_file(self, which: str) -> float:
        """Rms over channels of what is left, over what the file with its friction fitted leaves.

        Args:
            which: What predicts.
        """
        file = np.maximum(self.residual[REFITTED], TINY)
        return float(np.sqrt(np.nanmean((self.residual[which] / file) ** 2)))

    def worse(self, which: str, than: str = REFITTED) -> Iterator[Diagnostic]:
        """Channels that are significantly worse predicted than by a rival.

        Args:
            which: What predicts.
            than: The rival: "refitted" or "plain".
        """
        chance = self.chance.get(than, {}).get(which)
        if chance is None:
            return
        rival, own = self.residual[than], self.residual[which]
        matters = own**2 - rival**2 > (NOTICEABLE * self.signal) ** 2
        worse = (own > WORSE[than] * rival) & matters & (chance < CHANCE)
        for c in np.flatnonzero(worse).tolist():
            yield diagnose(
                "estimate.worse-than-file"
                if than == REFITTED
                else "estimate.worse-than-plain",
                channel_label(self.method, self.channels[c]),
                float(own[c] / max(rival[c], TINY)),
                method=self.method,
                predicts=phrase(which),
                of=phrase(self.of),
                rival=phrase(than),
                residual=own[c],
                least=rival[c],
                unit=self.units[c],
                best=phrase(self.best),
            )


Prediction = tuple[Array, Array]
"""Values of the unknowns, (p,), and constants of the channels, (C,)."""


def prediction_errors(
    problem: Problem,
    of: str,
    pairs: Iterable[tuple[Mapping[str, Prediction], Sequence[RowProducts]]],
) -> PredictionErrors:
    """What predictions leave of rows.

    Args:
        problem: Whose unknowns and channels.
        of: As of the errors.
        pairs: Predictions by what makes them, and parts of the rows that they are held against.
    """
    none = np.zeros(len(problem.names))
    squares: dict[str, list[Array]] = {}
    signal: list[Array] = []
    unseen: list[RowProducts] = []
    for predictions, parts in pairs:
        for name, (values, constants) in predictions.items():
            squares.setdefault(name, []).extend(
                part.squares(values, constants) for part in parts
            )
        zero = sum_of(parts).constants(none)
        signal += [part.squares(none, zero) for part in parts]
        unseen += parts
    rows = sum_of(unseen)
    used = np.where(rows.enough, rows.rows, np.nan)
    return PredictionErrors(
        method=problem.method,
        of=of,
        channels=problem.channels,
        units=channel_units(problem.tree, problem.method),
        rows=rows.rows,
        signal=np.sqrt(np.sum(signal, axis=0) / used),
        residual={
            name: np.sqrt(np.sum(each, axis=0) / used) for name, each in squares.items()
        },
        chance={
            rival: {
                name: _chance(each, squares[rival]) for name, each in squares.items()
            }
            for rival in (REFITTED, PLAIN)
            if rival in squares
        },
    )


def _chance(squares: Sequence[Array], rival: Sequence[Array]) -> Array:
    """Of ratios of squares, part by part, whose logarithms are so large on average, (C,).

    By Student's t over the parts, for the largest of all channels.

    Args:
        squares: What is left of every part, (parts, C).
        rival: What the other predictions leave.
    """
    from scipy.special import stdtr

    ratio = np.log(np.add(squares, TINY) / np.add(rival, TINY))
    count = len(ratio)
    error = ratio.std(axis=0, ddof=1) / np.sqrt(count)
    alone = stdtr(count - 1, -ratio.mean(axis=0) / np.where(error > 0, error, np.inf))
    return np.asarray(np.minimum(alone * ratio.shape[1], 1.0))


def predictions_of(
    rows: RowProducts, models: Mapping[str, Array]
) -> dict[str, Prediction]:
    """Values and constants that suit the rows by what predicts; the file alone has none."""
    none = np.zeros(len(rows.channels))
    return {
        name: (values, none if name == FILE else rows.constants(values))
        for name, values in models.items()
    }


def errors_of_another(
    problem: Problem, source: Source, models: Mapping[str, Array]
) -> PredictionErrors:
    """What a model file and estimates leave of another recording.

    All but the file as it is stand about the mean of what they leave of the plate: its zero
    belongs to a recording.

    Args:
        problem: The other recording.
        source: The same, faults of the instrument taken back.
        models: Values of the unknowns by what says them.
    """
    offset = problem.method == "external"
    parts = products_of(problem, source, offset, whole=True, per_cutoff=ROWS_PER_CUTOFF)
    models_of_rows = predictions_of(parts.whole, models)
    return prediction_errors(problem, "another", [(models_of_rows, parts.each)])
