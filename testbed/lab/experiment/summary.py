"""A run in a few sentences: what was found, how good it is; and whether the claim holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from testbed.bodies.verdict import WELL, verdict_of
from testbed.core.base.diagnostics import paragraphs, sentences
from testbed.core.base.errors import few, plural, round_significant
from testbed.lab.experiment.score import share_of_signal

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from testbed.bodies.posterior import Posterior
    from testbed.lab.experiment.run import Run

SIGNALS = {"wrench": "base wrench", "torque": "rigid-body torques"}
"""Of an `Accuracy`."""


def summary(run: Run) -> list[str]:
    """What a person reads first, a sentence each; the verdict is apart.

    Args:
        run: The run.
    """
    if not run.estimates:
        return [headline(run), *_cautions(run)]
    return [
        headline(run),
        *accuracy_lines(run),
        f"Data: {_data(run)}.",
        *_cautions(run),
    ]


def accuracy_lines(run: Run) -> list[str]:
    """Errors of the parameters, and what is left of another motion's signals, a sentence each.

    Args:
        run: The run.
    """
    return [*_parameters(run), *_measured(run)]


def headline(run: Run) -> str:
    """The first sentence: how well force plate and joint torques predict what the robot does.

    Args:
        run: The run.
    """
    made = run.posterior.values()
    if not (run.estimates or made):
        return f"From {_data(run)} no estimate could be made."
    if made or run.score is None:
        said = verdict_of(run.estimates.values(), made, doubts=run.diagnostics)
        shown = (
            [each for each in parts if each[:6] != "Remedy"]
            for parts in paragraphs(said)
        )
        first = [f"{text[0].upper()}{text[1:]}." for text in map(". ".join, shown)]
        return " ".join([*first, *data_lines(made, well=said[0].code == WELL)])
    errors = _prediction_errors(run)
    if not errors:
        return f"From {_data(run)} nothing can be predicted: the robot makes no force."
    where = "a held-out motion" if run.validation else "the motion used for the fit"
    listed = "; ".join(errors)
    return f"Prediction error on {where}, rms relative to the signal: {listed}{assumed(run)}."


def _prediction_errors(run: Run) -> list[str]:
    """Errors of the signals that a sensor or the robot shows, a phrase a signal."""
    part = run.tree.is_part  # whose joints carry more than what the sensor feels
    errors: dict[str, list[str]] = {}
    for name, signal in ({"wrench": "sensor wrench"} if part else SIGNALS).items():
        for method, accuracy in (
            {} if run.score is None else run.score.accuracy
        ).items():
            share = getattr(accuracy, name)
            if share is not None:
                phrase = f"{percent(share)} by the {run.estimates[method].instrument}"
                errors.setdefault(signal, []).append(phrase)
    return [f"{signal} {', '.join(phrases)}" for signal, phrases in errors.items()]


def assumed(run: Run) -> str:
    """What the experiment assumes of the torque constants; "" if nothing."""
    table = (
        {}
        if run.experiment is None
        else run.experiment.measurement.torque_constant_error
    )
    sizes = sorted({abs(error) for error in table.values() if error})
    if not sizes or "internal" not in run.estimates:
        return ""
    least, most = (f"{100 * size:.3g}" for size in (sizes[0], sizes[-1]))
    size = least if least == most else f"{least} to {most}"
    return f" (simulated torque constants are {size} % off)"


def _parameters(run: Run) -> list[str]:
    """Median error and largest error over sigma of the minimal parameters, by method."""
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
            parts.append(f"median error {percent(float(np.median(relative)))}")
        if z.size:
            rest = " (without friction)" if estimate.joint_terms else ""
            parts.append(f"largest error {z.max():.3g} standard deviations{rest}")
        phrases += [", ".join(parts)] if len(parts) > 1 else []
    return [f"Base parameters: {'; '.join(phrases)}."] if phrases else []


def data_lines(found: Iterable[Posterior], *, well: bool) -> Iterator[str]:
    """What of the model file a recording settles, a sentence a method.

    Args:
        found: Of one recording, one a method.
        well: Whether the verdict has no reservations.
    """
    by = "By" if well else "With these reservations, by"
    for each in found:
        whole = plural(each.count, "parameter")
        if not each.used:
            yield f"{by} the {each.instrument} this recording determines all {whole}."
            continue
        own = each.determined
        names = f": {few(list(own))}" if own else ""
        yield (
            f"{by} the {each.instrument} this recording determines {len(own)} of {whole}{names}; "
            "for the rest the model file's values stand, as far as the data do not change them."
        )


def _measured(run: Run) -> list[str]:
    """What is left of another motion's signals, noise among it, a sentence for all; or nothing."""
    phrases = []
    for method, found in run.validation.items():
        roots = np.sqrt(found.rows)
        signal, *errors = (
            np.nan_to_num(roots * x) for x in (found.signal, found.error, found.allowed)
        )
        shares = [share_of_signal(error, signal, found.units) for error in errors]
        known = [percent(share) for share in shares if share is not None]
        if len(known) == len(shares):
            what = "base wrench" if method == "external" else "joint torques"
            phrases.append(f"{what} {known[0]}, expected {known[1]}")
    said = "; ".join(phrases)
    if not phrases:
        return []
    return [f"Rms of measured minus predicted there, in percent of the signal: {said}."]


def _data(run: Run) -> str:
    recording = run.recording
    length = float(recording.time[-1] - recording.time[0])
    return f"{length:.3g} s at {recording.rate:.4g} Hz of {run.tree.name}"


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
    count = len(sentences(run.diagnostics))
    verb = "is" if count == 1 else "are"
    return [f"There {verb} {plural(count, 'warning')}."] if count else []


def obtained(run: Run, metric: str) -> str:
    """A metric as it is printed; that there is none, if so."""
    return f"{run.metrics[metric]:.3g}" if metric in run.metrics else "not there"


def percent(share: float) -> str:
    """A share with two digits: 0.03 %, 160 %."""
    return f"{round_significant(100 * share, 2):g} %"
