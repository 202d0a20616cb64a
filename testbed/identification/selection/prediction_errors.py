"""What a model file and estimates leave of data that they have not seen, beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.codec import with_properties
from testbed.diagnostics import Diagnostic, diagnose, phrase
from testbed.identification.estimate import Method, channel_label, channel_units
from testbed.identification.problem import Problem
from testbed.identification.selection.row_products import RowProducts

FILE, REFITTED, PLAIN, POSTERIOR = "file", "refitted", "plain", "posterior"
"""The model file as it is; with the plate's zero, or friction and offsets, fitted; least squares;
with the file as prior."""

WORSE = 1.05
"""Error over that of the model file with its friction that is worth a word."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """What is left of signals that no fit has seen.

    Attributes:
        method: By plate or by torques.
        of: "halves": both halves of the recording, each by the other one; "faster": its fast
            parts by the slow ones; "another": another recording.
        channels: The measured channels, (C,).
        units: One each, N or N m.
        signal: Rms of the channels, of a plate with an unknown zero about their mean, (C,).
        residual: Rms of what is left, (C,) [N, N m], by what predicts: "file", "refitted",
            "plain", "posterior".
    """

    method: Method
    of: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    signal: Array
    residual: Mapping[str, Array]

    __get_pydantic_core_schema__ = with_properties("best")

    @property
    def best(self) -> str:
        """What leaves least."""
        return min(self.residual, key=self.over_file)

    def over_file(self, which: str) -> float:
        """Rms over channels of what is left, over what the file with its friction fitted leaves.

        Args:
            which: What predicts.
        """
        file = np.maximum(self.residual[REFITTED], np.finfo(float).tiny)
        return float(np.sqrt(np.nanmean((self.residual[which] / file) ** 2)))

    def worse_than_file(self, which: str) -> Iterator[Diagnostic]:
        """Channels that are predicted worse than by the model file with its friction fitted.

        Args:
            which: What predicts.
        """
        file, own = self.residual[REFITTED], self.residual.get(which, self.residual[REFITTED])
        for c in np.flatnonzero(own > WORSE * file).tolist():
            yield diagnose(
                "estimate.worse-than-file",
                channel_label(self.method, self.channels[c]),
                float(own[c] / max(file[c], np.finfo(float).tiny)),
                method=self.method,
                predicts=phrase(which),
                of=phrase(self.of),
                file=phrase(REFITTED),
                residual=own[c],
                least=file[c],
                unit=self.units[c],
                best=phrase(self.best),
            )


Prediction = tuple[Array, Array]
"""Values of the unknowns, (p,), and constants of the channels, (C,)."""


def prediction_errors(
    problem: Problem, of: str, pairs: Iterable[tuple[Mapping[str, Prediction], RowProducts]]
) -> PredictionErrors:
    """What predictions leave of rows.

    Args:
        problem: Whose unknowns and channels.
        of: As of the errors.
        pairs: Predictions by what makes them, and the rows that these are held against.
    """
    count = len(problem.channels)
    squares: dict[str, Array] = {}
    signal, rows = np.zeros((2, count))
    for predictions, unseen in pairs:
        none = np.zeros(len(problem.names))
        for name, (values, constants) in predictions.items():
            squares[name] = squares.get(name, np.zeros(count)) + unseen.squares(values, constants)
        signal, rows = signal + unseen.squares(none, unseen.constants(none)), rows + unseen.rows
    rows = np.where(rows > 0, rows, np.nan)
    return PredictionErrors(
        method=problem.method,
        of=of,
        channels=problem.channels,
        units=channel_units(problem.tree, problem.method),
        signal=np.sqrt(signal / rows),
        residual={name: np.sqrt(each / rows) for name, each in squares.items()},
    )
