"""Prediction errors of the model file and of estimates on data that no fit used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.bodies.row_products import RowProducts, row_parts, sum_row_products
from testbed.core.base.arrays import Array
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnostic, cause_phrase, make_diagnostic
from testbed.core.estimation.estimate import channel_label, channel_units
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.estimation.regression.windows import ROWS_PER_CUTOFF
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.source import Source

FILE, REFITTED, LEAST_SQUARES = "file", "refitted", "plain"
POSTERIOR, CONSISTENT = "posterior", "consistent"
"""Predictions: model file unchanged; model file with the plate's zero, or friction and offsets,
fitted; least squares; estimate with the file as prior; physically consistent bodies."""

MAX_ERROR_RATIOS = {REFITTED: 1.05, LEAST_SQUARES: 1.2}
"""Ratio to a rival's prediction error above which an error is reported, by rival: model file with
fitted friction, least squares."""

MIN_ERROR_INCREASE = 5e-3
"""Smallest reported error increase, root of the difference of squares, over the signal."""

MAX_P_VALUE = 0.01
"""Largest p-value of a reported increase of a prediction error."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Prediction errors of each channel on measurements that no fit used.

    Attributes:
        method: "wrench" for the force plate, "torque" for joint torques.
        of: Kind of the predicted data. "like": each eighth of the recording, predicted from the
            other eighths; "faster": the fast parts of the recording, predicted from the slow parts;
            "another": another recording.
        channels: Names of the C measured channels, (C,).
        units: Units of the channels, N or N m, (C,).
        rows: Number of rows of each channel, (C,).
        signal: Rms signal of each channel, (C,) [N, N m]; about the mean if the zero of the force
            plate is unknown. Signals and errors are nan for channels with too few rows.
        residual: Rms prediction errors, (C,) [N, N m], keyed by prediction: "file", "refitted",
            "plain", "posterior", "consistent".
        chance: One-sided p-values for errors larger than those of a rival prediction, (C,), keyed
            by rival ("refitted" or "plain") and then by prediction; corrected for the number of
            channels.
    """

    method: Signal
    of: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rows: Array
    signal: Array
    residual: Mapping[str, Array]
    chance: Mapping[str, Mapping[str, Array]]

    __get_pydantic_core_schema__ = schema_with_properties("best_method")

    @property
    def best_method(self) -> str:
        """Name of the prediction with the smallest error over all channels (`over_file`)."""
        return min(self.residual, key=self.over_file)

    def merged_with(self, other: PredictionErrors) -> PredictionErrors:
        """Prediction errors merged with the errors of other predictions of the same data.

        Predictions in both keep the errors and p-values of this object.

        Args:
            other: Errors of the other predictions. P-values for rivals that are missing in `chance`
                of this object are dropped.
        """
        residual = {**other.residual, **self.residual}
        chance = {
            than: {**other.chance.get(than, {}), **chances}
            for than, chances in self.chance.items()
        }
        return replace(self, residual=residual, chance=chance)

    def share(self, which: str) -> Array:
        """Rms prediction error over rms signal, (C,); nan for channels without a signal.

        Args:
            which: Name of the prediction.
        """
        signal = np.where(self.signal > 0, self.signal, np.nan)
        return self.residual[which] / signal

    def over_file(self, which: str) -> float:
        """Rms, over the channels, of the error relative to the model file with fitted friction.

        Channels with too few rows are left out.

        Args:
            which: Name of the prediction.
        """
        file = np.maximum(self.residual[REFITTED], SMALLEST_POSITIVE)
        return float(np.sqrt(np.nanmean((self.residual[which] / file) ** 2)))

    def worse_channels(self, which: str, than: str = REFITTED) -> Iterator[Diagnostic]:
        """Diagnostics of channels that one prediction predicts significantly worse than another.

        A channel is reported if the error is larger by a factor over 1.05 ("refitted") or 1.2
        ("plain") with a p-value below 0.01, and the root of the difference of the squared errors
        exceeds 0.5 % of the signal. No channel is reported if there are no p-values for the two
        predictions.

        Args:
            which: Name of the prediction.
            than: Name of the other prediction: "refitted" or "plain".
        """
        chance = self.chance.get(than, {}).get(which)
        if chance is None:
            return
        rival_residual, residual = self.residual[than], self.residual[which]
        is_noticeable = (
            residual**2 - rival_residual**2 > (MIN_ERROR_INCREASE * self.signal) ** 2
        )
        is_worse = (
            (residual > MAX_ERROR_RATIOS[than] * rival_residual)
            & is_noticeable
            & (chance < MAX_P_VALUE)
        )
        for c in np.flatnonzero(is_worse).tolist():
            yield make_diagnostic(
                "estimate.worse-than-file"
                if than == REFITTED
                else "estimate.worse-than-plain",
                channel_label(self.method, self.channels[c]),
                float(residual[c] / max(rival_residual[c], SMALLEST_POSITIVE)),
                method=self.method,
                predicts=cause_phrase(which),
                of=cause_phrase(self.of),
                rival=cause_phrase(than),
                residual=residual[c],
                least=rival_residual[c],
                unit=self.units[c],
                best=cause_phrase(self.best_method),
            )


Prediction = tuple[Array, Array]
"""Values of the unknowns, (p,), and constants of the channels, (C,)."""


def prediction_errors(
    problem: Problem,
    held_out_kind: str,
    pairs: Iterable[tuple[Mapping[str, Prediction], Sequence[RowProducts]]],
) -> PredictionErrors:
    """Rms errors and p-values of several predictions on held-out rows, channel by channel.

    Args:
        problem: Problem with the unknowns and the channels.
        held_out_kind: Kind of the predicted data: "like", "faster" or "another"
            (`PredictionErrors.of`).
        pairs: Pairs of predictions, keyed by name, and the held-out parts of the rows that they
            predict. The errors are computed over the parts of all pairs.
    """
    zeros = np.zeros(len(problem.names))
    squares: dict[str, list[Array]] = {}
    signal: list[Array] = []
    held_out: list[RowProducts] = []
    for predictions, parts in pairs:
        for name, (values, constants) in predictions.items():
            squares.setdefault(name, []).extend(
                part.residual_squares(values, constants) for part in parts
            )
        mean = sum_row_products(parts).mean_residuals(zeros)
        signal += [part.residual_squares(zeros, mean) for part in parts]
        held_out += parts
    rows = sum_row_products(held_out)
    used = np.where(rows.has_enough_rows, rows.rows, np.nan)
    return PredictionErrors(
        method=problem.method,
        of=held_out_kind,
        channels=problem.channels,
        units=channel_units(problem.tree, problem.method),
        rows=rows.rows,
        signal=np.sqrt(np.sum(signal, axis=0) / used),
        residual={
            name: np.sqrt(np.sum(each, axis=0) / used) for name, each in squares.items()
        },
        chance={
            rival: {
                name: _p_values(each, squares[rival]) for name, each in squares.items()
            }
            for rival in (REFITTED, LEAST_SQUARES)
            if rival in squares
        },
    )


def _p_values(squares: Sequence[Array], rival: Sequence[Array]) -> Array:
    """One-sided p-values for larger mean squared errors than a rival prediction, (C,).

    Student's t-test is applied to the logarithms of the ratios of the parts' squared errors, with
    Bonferroni's correction for the number of channels.

    Args:
        squares: Sums of squared errors of each part, (parts, C), for C channels.
        rival: Sums of squared errors of the rival prediction, (parts, C).
    """
    from scipy.special import stdtr

    ratio = np.log(
        np.add(squares, SMALLEST_POSITIVE) / np.add(rival, SMALLEST_POSITIVE)
    )
    count = len(ratio)
    error = ratio.std(axis=0, ddof=1) / np.sqrt(count)
    p_values = stdtr(
        count - 1, -ratio.mean(axis=0) / np.where(error > 0, error, np.inf)
    )
    return np.asarray(np.minimum(p_values * ratio.shape[1], 1.0))


def fitted_predictions(
    rows: RowProducts, models: Mapping[str, Array]
) -> dict[str, Prediction]:
    """Predictions with channel constants fitted to rows, keyed by name.

    The constant of a channel is the mean residual if the constant is unknown, otherwise zero. All
    constants of the prediction "file" are zero.

    Args:
        rows: Products of the rows.
        models: Values of the unknowns, (p,), keyed by name of the prediction.
    """
    zeros = np.zeros(len(rows.channels))
    return {
        name: (values, zeros if name == FILE else rows.mean_residuals(values))
        for name, values in models.items()
    }


def errors_on_recording(
    problem: Problem, source: Source, models: Mapping[str, Array]
) -> PredictionErrors:
    """Prediction errors of a model file and estimates on another recording.

    The zero of the force plate differs between recordings. Therefore the mean residual of each
    channel of the plate is subtracted, except for the unchanged model file.

    Args:
        problem: Problem of the other recording.
        source: The other recording, with instrument faults corrected.
        models: Values of the unknowns, (p,), keyed by name of the prediction.
    """
    offset = problem.method == "wrench"
    parts = row_parts(problem, source, offset, whole=True, per_cutoff=ROWS_PER_CUTOFF)
    models_of_rows = fitted_predictions(parts.total, models)
    return prediction_errors(problem, "another", [(models_of_rows, parts.parts)])
