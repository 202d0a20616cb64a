"""What a recording adds to its model file: shares of the data, errors on held-out data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.applications.validate import Validation
from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import (
    CONSISTENT,
    FILE,
    PLAIN,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
)
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import phrase
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.estimation.estimate import NAMES
from testbed.view.section import Table

HEADS = {
    FILE: "model file",
    REFITTED: "file, friction fitted",
    PLAIN: "least squares",
    POSTERIOR: "with prior",
    CONSISTENT: "consistent",
}


def posterior_table(found: Posterior, most: int | None = None) -> Table:
    """Model file and estimate, with the share of the data; first bodies, by that share.

    Args:
        found: By one method.
        most: Rows; None for all.
    """
    bodies = np.argsort(-found.share[: found.count], kind="stable")
    order = [*bodies.tolist(), *range(found.count, len(found.names))][:most]
    sigma, before = found.sigma.tolist(), found.prior_sigma.tolist()
    rows = [
        [
            found.names[k],
            found.units[k],
            number_with_sigma(float(found.file[k]), before[k])
            if k < found.count
            else "free",
            number_with_sigma(float(found.values[k]), sigma[k]),
            f"{found.share[k]:.0%}",
        ]
        for k in order
    ]
    title = (
        f"{found.instrument}, with the model file as prior, whose bodies are wrong by "
        f"{found.prior_error:.0%} where the recording shows it: the estimate by file and "
        "recording; data: share of the file's variance that the recording removes; standard "
        "deviations for motions like this one"
    )
    return Table(
        ["parameter", "unit", "model file", "estimate", "data"], rows, title, ["unit"]
    )


def errors_table(found: PredictionErrors) -> Table:
    """What the model file and estimates leave of data that they have not seen.

    Args:
        found: By one method.
    """
    columns = {"channel": found.channels, "unit": found.units} | _error_columns(found)
    title = f"rms error of predictions of {phrase(found.of)}"
    return Table.of(columns, title, ["unit"])


def validation_table(found: Validation) -> Table:
    """Table of prediction errors on another recording, by candidate.

    Args:
        found: By one method.
    """
    columns: dict[str, Sequence[str]] = {"channel": found.channels, "unit": found.units}
    if found.errors is None:
        columns |= {"residual": _texts(found.residual)}
    else:
        columns |= _error_columns(found.errors, found.held)
    columns |= {
        "of signal": _texts(100 * found.relative_residual, " %"),
        "mean": _texts(found.mean),
        "noise": _texts(found.noise),
        "prediction std": _texts(found.spread),
        "ratio": _texts(found.ratio),
        "rows": [str(rows) for rows in found.rows],
    }
    return Table.of(
        columns,
        f"{NAMES[found.method]}, cross-validation on another recording"
        + "; * judged: all that follows is about it" * (found.errors is not None),
        left=["unit"],
        parts=[range(k, min(k + 4, len(columns))) for k in range(1, len(columns), 4)],
    )


def _error_columns(found: PredictionErrors, held: str = "") -> dict[str, list[str]]:
    """Columns of signals and errors by candidate; a star marks the reported one."""
    names = HEADS | (
        {REFITTED: "file, zero fitted"} if found.method == "external" else {}
    )
    errors = {name: found.residual[name] for name in HEADS if name in found.residual}
    return {"signal": _texts(found.signal)} | {
        names[name] + " *" * (name == held): _texts(each)
        for name, each in errors.items()
    }


def _texts(numbers: Array, unit: str = "") -> list[str]:
    return ["-" if np.isnan(each) else f"{each:.3g}{unit}" for each in numbers.tolist()]
