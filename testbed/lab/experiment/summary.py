"""Summary of a run in sentences: prediction errors, parameter errors, verdict on the claim."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from testbed.bodies.verdict import WELL_CODE, verdict_of
from testbed.core.base.diagnostics import diagnostic_paragraphs, sentences
from testbed.core.base.errors import count_with_noun, round_significant, shortened_list
from testbed.lab.experiment.score import relative_rms_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from testbed.bodies.posterior import Posterior
    from testbed.lab.experiment.run import Run

SIGNAL_NAMES = {"wrench": "base wrench", "torque": "rigid-body torques"}
"""Names of the signals of an `Accuracy`, by attribute."""


def summary(run: Run) -> list[str]:
    """Sentences on prediction errors, parameter errors, data and warnings of a run.

    Args:
        run: Run with or without estimates.
    """
    if not run.estimates:
        return [headline(run), *_warning_count(run)]
    return [
        headline(run),
        *accuracy_lines(run),
        f"Data: {_recording_size(run)}.",
        *_warning_count(run),
    ]


def accuracy_lines(run: Run) -> list[str]:
    """Sentences on parameter errors and on residuals of the validation recording.

    Args:
        run: Run with or without known truth.
    """
    return [*_parameter_errors(run), *_validation_residuals(run)]


def headline(run: Run) -> str:
    """First sentences of a summary: prediction errors from force plate and joint torques.

    For a recording without known truth, or with posteriors, they are instead the verdict on its
    estimates and the parameters that it determines.

    Args:
        run: Run with or without estimates.
    """
    posteriors = run.posterior.values()
    if not (run.estimates or posteriors):
        return f"From {_recording_size(run)} no estimate could be made."
    if posteriors or run.score is None:
        reservations = verdict_of(
            run.estimates.values(), posteriors, doubts=run.diagnostics
        )
        paragraph_parts = (
            [each for each in parts if each[:6] != "Remedy"]
            for parts in diagnostic_paragraphs(reservations)
        )
        texts = [
            f"{text[0].upper()}{text[1:]}." for text in map(". ".join, paragraph_parts)
        ]
        return " ".join(
            [
                *texts,
                *determined_parameter_lines(
                    posteriors, without_reservations=reservations[0].code == WELL_CODE
                ),
            ]
        )
    errors = _prediction_errors(run)
    if not errors:
        return f"From {_recording_size(run)} nothing can be predicted: the robot makes no force."
    motion = "a held-out motion" if run.validation else "the motion used for the fit"
    listed = "; ".join(errors)
    return (
        f"Prediction error on {motion}, rms relative to the signal: "
        f"{listed}{torque_constant_remark(run)}."
    )


def _prediction_errors(run: Run) -> list[str]:
    """Phrases with the prediction errors of each method, one phrase per signal."""
    is_part = run.tree.is_part  # joint torques then carry more bodies than the sensor
    errors: dict[str, list[str]] = {}
    for name, signal in (
        {"wrench": "sensor wrench"} if is_part else SIGNAL_NAMES
    ).items():
        for method, accuracy in (
            {} if run.score is None else run.score.accuracy
        ).items():
            share = getattr(accuracy, name)
            if share is not None:
                phrase = (
                    f"{percent_text(share)} by the {run.estimates[method].instrument}"
                )
                errors.setdefault(signal, []).append(phrase)
    return [f"{signal} {', '.join(phrases)}" for signal, phrases in errors.items()]


def torque_constant_remark(run: Run) -> str:
    """Remark on the simulated errors of the torque constants; "" without such errors."""
    table = (
        {}
        if run.experiment is None
        else run.experiment.measurement.torque_constant_error
    )
    sizes = sorted({abs(error) for error in table.values() if error})
    if not sizes or "torque" not in run.estimates:
        return ""
    smallest, largest = (f"{100 * size:.3g}" for size in (sizes[0], sizes[-1]))
    size = smallest if smallest == largest else f"{smallest} to {largest}"
    return f" (simulated torque constants are {size} % off)"


def _parameter_errors(run: Run) -> list[str]:
    """Sentence with the median and largest error of the base parameters, by method.

    The list is empty without known truth.
    """
    if run.score is None:
        return []
    phrases = []
    for method, estimate in run.estimates.items():
        errors, count = run.score.errors[method], estimate.minimal.count
        relative, z = (
            np.abs(x[:count][np.isfinite(x[:count])])
            for x in (errors.relative, errors.z)
        )
        parts = [f"{count} by the {estimate.instrument}"]
        if relative.size:
            parts.append(f"median error {percent_text(float(np.median(relative)))}")
        if z.size:
            remark = " (without friction)" if estimate.joint_terms else ""
            parts.append(f"largest error {z.max():.3g} standard deviations{remark}")
        phrases += [", ".join(parts)] if len(parts) > 1 else []
    return [f"Base parameters: {'; '.join(phrases)}."] if phrases else []


def determined_parameter_lines(
    posteriors: Iterable[Posterior], *, without_reservations: bool
) -> Iterator[str]:
    """Yield a sentence per method on the parameters that a recording determines.

    Args:
        posteriors: Estimates with the model file as prior, one per method.
        without_reservations: True if the verdict contains no reservations.
    """
    by = "By" if without_reservations else "With these reservations, by"
    for each in posteriors:
        total = count_with_noun(each.count, "parameter")
        if not each.used:
            yield f"{by} the {each.instrument} this recording determines all {total}."
            continue
        determined = each.determined
        names = f": {shortened_list(list(determined))}" if determined else ""
        yield (
            f"{by} the {each.instrument} this recording determines {len(determined)} of "
            f"{total}{names}; for the rest the model file's values stand, "
            "as far as the data do not change them."
        )


def _validation_residuals(run: Run) -> list[str]:
    """Sentence with the residuals of the validation recording relative to its signals.

    Residuals contain the sensor noise; each is followed by its expected value. The list is empty
    without validation.
    """
    phrases = []
    for method, validation in run.validation.items():
        roots = np.sqrt(validation.rows)
        signal, *errors = (
            np.nan_to_num(roots * x)
            for x in (validation.signal, validation.error, validation.expected_error)
        )
        shares = [
            relative_rms_error(error, signal, validation.units) for error in errors
        ]
        known = [percent_text(share) for share in shares if share is not None]
        if len(known) == len(shares):
            signal_name = "base wrench" if method == "wrench" else "joint torques"
            phrases.append(f"{signal_name} {known[0]}, expected {known[1]}")
    text = "; ".join(phrases)
    if not phrases:
        return []
    return [f"Rms of measured minus predicted there, in percent of the signal: {text}."]


def _recording_size(run: Run) -> str:
    """Sentence with length, sampling rate and robot of the recording."""
    recording = run.recording
    length = float(recording.time[-1] - recording.time[0])
    return f"{length:.3g} s at {recording.rate:.4g} Hz of {run.tree.name}"


def claim_verdict(run: Run) -> str:
    """Verdict on the claim, with the reasons if it fails; "" without claims.

    Args:
        run: Run of an experiment.
    """
    verdicts = run.verdicts
    if not verdicts or run.experiment is None:
        return ""
    failed = [name for name, holds in verdicts.items() if not holds]
    if not failed:
        return "The claim holds."
    claims = run.experiment.expect
    reasons = [
        f"{name.replace('_', ' ')} is {metric_text(run, name)}, claimed {claims[name].description}"
        for name in failed
    ]
    return f"The claim does not hold: {'; '.join(reasons)}."


def _warning_count(run: Run) -> list[str]:
    """Sentence with the number of warnings; an empty list without warnings."""
    count = len(sentences(run.diagnostics))
    verb = "is" if count == 1 else "are"
    return [f"There {verb} {count_with_noun(count, 'warning')}."] if count else []


def metric_text(run: Run, metric: str) -> str:
    """Text of a metric with three digits; "not there" if it is missing."""
    return f"{run.metrics[metric]:.3g}" if metric in run.metrics else "not there"


def percent_text(share: float) -> str:
    """Text of a fraction in percent with two digits, such as 0.03 % or 160 %."""
    return f"{round_significant(100 * share, 2):g} %"
