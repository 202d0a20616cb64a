"""A run in a few sentences: what was found, how good it is; and whether the claim holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from testbed.identification.estimate import METHODS, Method

if TYPE_CHECKING:
    from testbed.experiment.run import Run
    from testbed.identification.estimate import Estimate
    from testbed.identification.validate import Validation

_SOURCES = {"external": "the bedplate's reaction", "internal": "the joint torques"}


def summary(run: Run) -> list[str]:
    """What a person reads first, a sentence each; the verdict is apart.

    Args:
        run: The run.
    """
    if not run.estimates:
        return [headline(run), *_cautions(run)]
    told = [*_accuracy(run), *validation_lines(run.validation), *_cautions(run)]
    return [headline(run), _found(run), *told]


def headline(run: Run) -> str:
    """The one sentence: how well plate and torques know the robot.

    Args:
        run: The run.
    """
    shares = {
        method: run.metrics.get(f"{method}_rms_relative_error")
        for method in METHODS
        if method in run.estimates
    }
    known = {method: share for method, share in shares.items() if share is not None}
    if not shares:
        return f"From {_data(run)} no estimate could be made."
    if not known:
        told = "; ".join(_own_words(run.estimates[method]) for method in shares)
        return f"{told.replace('; The', '; the')}."
    if len(known) == 1:
        ((method, share),) = known.items()
        count = len(run.estimates[method].base.names)
        which = f"{count} parameters" if method == "internal" else "what joint torques could tell"
        return f"{_subject(method)} {which} to {percent(share)}."
    count = len(run.estimates["internal"].base.names)
    return (
        f"The bedplate gives the {count} parameters that both tell to "
        f"{percent(known['external'])}, the joint torques to {percent(known['internal'])}."
    )


def _subject(method: Method) -> str:
    return "The bedplate gives" if method == "external" else "The joint torques give"


def _own_words(estimate: Estimate) -> str:
    """What an estimate says of its own accuracy; the truth is not known."""
    base = estimate.base
    told = np.abs(base.values) > 0
    shares = base.sigma[told] / np.abs(base.values[told])
    half = f", half of them to {percent(float(np.median(shares)))} or better" if told.any() else ""
    return f"{_subject(estimate.method)} {len(base.names)} parameters{half}"


def _data(run: Run) -> str:
    recording = run.recording
    length = float(recording.time[-1] - recording.time[0])
    return f"{length:.3g} s at {recording.rate:.4g} Hz of {run.tree.name}"


def _found(run: Run) -> str:
    told = []
    for method, estimate in run.estimates.items():
        terms, count = len(estimate.joint_terms), len(estimate.base.names)
        more = f" and {terms} coefficients of the joints" if terms else ""
        told.append(f"{_SOURCES[method]} tell {count} inertial parameters{more}")
    told[0] = told[0].replace("reaction tell", "reaction tells")
    return f"From {_data(run)}, {', '.join(told)}."


def _accuracy(run: Run) -> list[str]:
    """Errors where the truth is known, else how well the estimates explain the data."""
    metrics = run.metrics
    sigmas = [
        f"{method} {metrics[f'{method}_max_z']:.3g}"
        for method in METHODS
        if f"{method}_max_z" in metrics
    ]
    return [f"Largest error in sigmas: {', '.join(sigmas)}."] if sigmas else _fit(run)


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
