"""A run in a few sentences: what was found, how good it is; and whether the claim holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from testbed.identification.estimate import METHODS, Method

if TYPE_CHECKING:
    from testbed.experiment.run import Run
    from testbed.identification.validate import Validation

_SOURCES = {"external": "the bedplate's reaction", "internal": "the joint torques"}


def summary(run: Run) -> list[str]:
    """What a person reads first, a sentence each; the verdict is apart.

    Args:
        run: The run.
    """
    return [_found(run), *_accuracy(run), *validation_lines(run.validation), *_cautions(run)]


def _found(run: Run) -> str:
    recording = run.recording
    length = float(recording.time[-1] - recording.time[0])
    data = f"{length:.3g} s at {recording.rate:.4g} Hz"
    told = []
    for method, estimate in run.estimates.items():
        terms, count = len(estimate.joint_terms), len(estimate.base.names)
        more = f" and {terms} coefficients of the joints" if terms else ""
        told.append(f"{_SOURCES[method]} tell {count} inertial parameters{more}")
    if not told:
        return f"From {data} of {run.tree.name} no estimate could be made."
    told[0] = told[0].replace("reaction tell", "reaction tells")
    return f"From {data} of {run.tree.name}, {', '.join(told)}."


def _accuracy(run: Run) -> list[str]:
    """Errors where the truth is known, else how well the estimates explain the data."""
    metrics = run.metrics
    errors = [
        f"{method} {percent(metrics[f'{method}_rms_relative_error'])}"
        for method in METHODS
        if f"{method}_rms_relative_error" in metrics
    ]
    if not errors:
        return _fit(run)
    lines = [f"Rms error against the truth: {', '.join(errors)}"]
    ratio = metrics.get("internal_to_external")
    if ratio is not None:
        lines[0] += f"; internal over external {ratio:.3g}"
    sigmas = [
        f"{method} {metrics[f'{method}_max_z']:.3g}"
        for method in METHODS
        if f"{method}_max_z" in metrics
    ]
    return [f"{lines[0]}.", f"Largest error in sigmas: {', '.join(sigmas)}."]


def validation_lines(validation: Mapping[Method, Validation]) -> list[str]:
    """How well estimates foretell another motion, a sentence for all; none without.

    Args:
        validation: By method.
    """
    told = []
    for method, found in validation.items():
        ratio = np.where(found.matters, found.ratio, np.nan)
        if not np.isnan(ratio).all():
            worst = int(np.nanargmax(ratio))
            told.append(f"{method} {ratio[worst]:.3g} ({found.channels[worst]})")
    if not told:
        return []
    return [
        "On a motion that no estimate has seen, the largest residual over what noise and sigma "
        f"allow: {', '.join(told)}."
    ]


def _fit(run: Run) -> list[str]:
    worst = [
        f"{method} {percent(float(e.relative_residual.max()))} "
        f"({e.channels[int(e.relative_residual.argmax())]})"
        for method, e in run.estimates.items()
    ]
    return [f"Largest residual, as part of its channel: {', '.join(worst)}."] if worst else []


def verdict(run: Run) -> str:
    """Whether the claim holds, and if not, why; "" for a run without claims.

    Args:
        run: The run.
    """
    verdicts = run.verdicts
    if not verdicts or run.experiment is None:
        return ""
    failed = [name for name, holds in verdicts.items() if not holds]
    if not failed:
        return "The claim holds."
    claims = run.experiment.expect
    reasons = [
        f"{name.replace('_', ' ')} is {obtained(run, name)}, claimed {claims[name].wanted}"
        for name in failed
    ]
    return f"The claim does not hold: {'; '.join(reasons)}."


def _cautions(run: Run) -> list[str]:
    count = len(run.warnings)
    if not count:
        return []
    return ["There is one warning." if count == 1 else f"There are {count} warnings."]


def obtained(run: Run, metric: str) -> str:
    """A metric as it is printed; that there is none, if so."""
    return f"{run.metrics[metric]:.3g}" if metric in run.metrics else "not there"


def percent(share: float) -> str:
    """A share with two digits: 0.03 %, 160 %."""
    return f"{float(f'{100 * share:.2g}'):g} %"
