"""What a recording adds to its model file: shares of the data, errors on held-out data."""

from __future__ import annotations

import numpy as np

from testbed.diagnostics import phrase
from testbed.identification.estimate import number_with_sigma
from testbed.identification.posterior import Posterior
from testbed.identification.selection.prediction_errors import (
    CONSISTENT,
    FILE,
    PLAIN,
    POSTERIOR,
    REFITTED,
    PredictionErrors,
)
from testbed.reporting.section import Table

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
            number_with_sigma(float(found.file[k]), before[k]) if k < found.count else "free",
            number_with_sigma(float(found.values[k]), sigma[k]),
            f"{found.share[k]:.0%}",
        ]
        for k in order
    ]
    title = (
        f"{found.instrument}: the model file, whose bodies are uncertain by "
        f"{found.prior_error:.0%}, and the estimate by file and recording; data: share of the "
        "file's variance that the recording removes; standard deviations for motions like this one"
    )
    return Table(["parameter", "unit", "model file", "estimate", "data"], rows, title, ["unit"])


def errors_table(found: PredictionErrors) -> Table:
    """What the model file and estimates leave of data that they have not seen.

    Args:
        found: By one method.
    """
    residual = {name: found.residual[name] for name in HEADS if name in found.residual}
    rows = [
        [name, unit, f"{found.signal[c]:.3g}", *(f"{x[c]:.3g}" for x in residual.values())]
        for c, (name, unit) in enumerate(zip(found.channels, found.units, strict=True))
    ]
    names = HEADS | ({REFITTED: "file, zero fitted"} if found.method == "external" else {})
    heads = ["channel", "unit", "signal", *(names[name] for name in residual)]
    title = f"rms error of predictions of {phrase(found.of)}"
    return Table(heads, rows, title, ["unit"])
