"""Tables of estimates with the model file as prior, and of prediction errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.applications.validate import Validation
from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import (
    CONSISTENT,
    FILE,
    LEAST_SQUARES,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
)
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import cause_phrase
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.estimation.estimate import METHOD_LABELS
from testbed.view.section import Table

CANDIDATE_HEADS = {
    FILE: "model file",
    REFITTED: "file, friction fitted",
    LEAST_SQUARES: "least squares",
    POSTERIOR: "with prior",
    CONSISTENT: "consistent",
}
"""Column heads of the predictions."""


def posterior_table(posterior: Posterior, max_rows: int | None = None) -> Table:
    """Table of prior value, posterior value with sigma, and data share of each parameter.

    The data share is the fraction of the prior variance that the data remove. Minimal parameters of
    the bodies come first, in the order of decreasing data share; then joint terms, whose prior is
    given as "free".

    Args:
        posterior: Posterior by one method.
        max_rows: Largest number of rows; None for all parameters.
    """
    bodies = np.argsort(-posterior.share[: posterior.count], kind="stable")
    order = [*bodies.tolist(), *range(posterior.count, len(posterior.names))][:max_rows]
    sigma, prior_sigma = posterior.sigma.tolist(), posterior.prior_sigma.tolist()
    rows = [
        [
            posterior.names[k],
            posterior.units[k],
            number_with_sigma(float(posterior.file[k]), prior_sigma[k])
            if k < posterior.count
            else "free",
            number_with_sigma(float(posterior.values[k]), sigma[k]),
            f"{posterior.share[k]:.0%}",
        ]
        for k in order
    ]
    title = (
        f"{posterior.instrument}, with the model file as prior, whose bodies are wrong by "
        f"{posterior.prior_error:.0%} where the recording shows it: the estimate by file and "
        "recording; data: share of the file's variance that the recording removes; standard "
        "deviations for motions like this one"
    )
    return Table(
        ["parameter", "unit", "model file", "estimate", "data"], rows, title, ["unit"]
    )


def prediction_error_table(errors: PredictionErrors) -> Table:
    """Table of rms signal and rms prediction errors, by channel (row) and candidate (column).

    Candidates are the model file and the estimates. The title describes the held-out data.

    Args:
        errors: Prediction errors of one method.
    """
    columns = {"channel": errors.channels, "unit": errors.units} | _error_columns(
        errors
    )
    title = f"rms error of predictions of {cause_phrase(errors.of)}"
    return Table.from_columns(columns, title, ["unit"])


def validation_table(validation: Validation) -> Table:
    """Table of prediction errors on another recording, by channel.

    The first columns are the rms errors of all candidates, with a star for the validated estimate,
    or of this estimate only. The other columns refer to this estimate: ratio of residual to rms
    signal, mean residual, rms noise, predicted standard deviation, ratio of residual to expected
    residual, and number of rows.

    Args:
        validation: Validation of one method.
    """
    columns: dict[str, Sequence[str]] = {
        "channel": validation.channels,
        "unit": validation.units,
    }
    if validation.errors is None:
        columns |= {"residual": _number_texts(validation.residual)}
    else:
        columns |= _error_columns(validation.errors, validation.held)
    columns |= {
        "of signal": _number_texts(100 * validation.relative_residual, " %"),
        "mean": _number_texts(validation.mean),
        "noise": _number_texts(validation.noise),
        "prediction std": _number_texts(validation.spread),
        "ratio": _number_texts(validation.ratio),
        "rows": [str(rows) for rows in validation.rows],
    }
    return Table.from_columns(
        columns,
        f"{METHOD_LABELS[validation.method]}, cross-validation on another recording"
        + "; * judged: all that follows is about it" * (validation.errors is not None),
        left=["unit"],
        parts=[range(k, min(k + 4, len(columns))) for k in range(1, len(columns), 4)],
    )


def _error_columns(
    prediction_errors: PredictionErrors, reported: str = ""
) -> dict[str, list[str]]:
    """Columns with the rms signal, and with the rms error of each candidate.

    A star marks the reported candidate. Candidates that have no errors are left out.

    Args:
        prediction_errors: Prediction errors of one method.
        reported: Name of the reported candidate; "" for no star.
    """
    heads = CANDIDATE_HEADS | (
        {REFITTED: "file, zero fitted"} if prediction_errors.method == "wrench" else {}
    )
    errors = {
        name: prediction_errors.residual[name]
        for name in CANDIDATE_HEADS
        if name in prediction_errors.residual
    }
    return {"signal": _number_texts(prediction_errors.signal)} | {
        heads[name] + " *" * (name == reported): _number_texts(each)
        for name, each in errors.items()
    }


def _number_texts(numbers: Array, unit: str = "") -> list[str]:
    """Texts of numbers with their unit; "-" for nan."""
    return ["-" if np.isnan(each) else f"{each:.3g}{unit}" for each in numbers.tolist()]
