"""A run in a few sentences: what was found, how good it is; and whether the claim holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from testbed.bodies.verdict import WELL, verdict_of
from testbed.core.base.diagnostics import paragraphs, sentences
from testbed.core.base.errors import few, plural, round_significant
from testbed.lab.experiment.score import share_of_signal

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from testbed.bodies.posterior import Posterior
    from testbed.core.base.arrays import Array
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
    return [headline(run), *accuracy_lines(run), f"Data: {_data(run)}.", *_cautions(run)]


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
        shown = ([each for each in parts if each[:6] != "Remedy"] for parts in paragraphs(said))
        first = [f"{text[0].upper()}{text[1:]}." for text in map(". ".join, shown)]
        return " ".join([*first, *data_lines(made, well=said[0].code == WELL)])
    phrases = []
    for name in ("wrench", "torque"):
        shares = {m: getattr(found, name) for m, found in run.score.accuracy.items()}
        if run.tree.is_part and name == "torque":
            continue  # of joints that carry more than what the sensor feels
        by = [
            f"{percent(x)} by the {run.estimates[m].instrument}"
            for m, x in shares.items()
            if x is not None
        ]
        signal = "sensor wrench" if run.tree.is_part else SIGNALS[name]
        phrases += [f"{signal} {', '.join(by)}"] if by else []
    if not phrases:
        return f"From {_data(run)} nothing can be predicted: the robot makes no force."
    where = "a held-out motion" if run.validation else "the motion used for the fit"
    errors = "; ".join(phrases)
    return f"Prediction error on {where}, rms relative to the signal: {errors}{assumed(run)}."


def assumed(run: Run) -> str:
    """What the experiment assumes of the torque constants; "" if nothing."""
    table = {} if run.experiment is None else run.experiment.measurement.torque_constant_error
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
        errors = run.score.errors[method]
        relative, z = (np.abs(x[: estimate.minimal.count]) for x in (errors.relative, errors.z))
        middle, most = _of_numbers(np.median, relative), _of_numbers(np.max, z)
        rest = " (without friction)" if estimate.joint_terms else ""
        parts = [] if middle is None else [f"median error {percent(middle)}"]
        parts += [] if most is None else [f"largest error {most:.3g} standard deviations{rest}"]
        if parts:
            by = f"{estimate.minimal.count} by the {estimate.instrument}"
            phrases.append(f"{by}, {', '.join(parts)}")
    return [f"Base parameters: {'; '.join(phrases)}."] if phrases else []


def _of_numbers(function: Callable[[Array], Any], values: Array) -> float | None:
    there = values[np.isfinite(values)]
    return float(function(there)) if there.size else None


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
        rows = np.sqrt(np.array(found.rows, dtype=float))
        signal, left, allowed = (
            np.nan_to_num(rows * x) for x in (found.signal, found.error, found.allowed)
        )
        share, usual = (share_of_signal(x, signal, found.units) for x in (left, allowed))
        if share is not None and usual is not None:
            what = "base wrench" if method == "external" else "joint torques"
            phrases.append(f"{what} {percent(share)}, expected {percent(usual)}")
    return (
        [f"Rms of measured minus predicted there, in percent of the signal: {'; '.join(phrases)}."]
        if phrases
        else []
    )


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
    if not count:
        return []
    return [f"There {'is' if count == 1 else 'are'} {plural(count, 'warning')}."]


def obtained(run: Run, metric: str) -> str:
    """A metric as it is printed; that there is none, if so."""
    return f"{run.metrics[metric]:.3g}" if metric in run.metrics else "not there"


def percent(share: float) -> str:
    """A share with two digits: 0.03 %, 160 %."""
    return f"{round_significant(100 * share, 2):g} %"
