"""The verdict on estimates of a recording: what is wrong, the gravest first, or what shows it well.

Errors on held-out parts are its evidence, where there are some; else residuals.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np

from testbed.bodies.posterior import Posterior
from testbed.bodies.prediction_errors import POSTERIOR
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import (
    Diagnostic,
    diagnose,
    messages,
    ordered,
    phrase,
)
from testbed.core.estimation.diagnostics.diagnosis import THRESHOLDS
from testbed.core.estimation.diagnostics.torques import diagnostics_of
from testbed.core.estimation.estimate import Estimate, channel_label, matters
from testbed.core.estimation.regression.normal_equations import TINY

NOTHING = 1.0
"""Error of the model file's bodies, in parts of themselves, with which it says next to nothing."""

EPISODE, LONGEST, FAINT = 4.0, 2, 0.05
"""Times the usual residual of a part that is no model's error; most parts in a row of it; part of
the channel's signal that it is at least."""

OF_RECORDING = {
    "recording.unexplained",
    "torque.gains",
    "torque.size",
    "position.step",
    "position.still",
    "mapping.unlikely",
}
"""Doubts of a recording that concern all that is identified from it."""

MODEL_ERROR = "model-error."
"""Codes of model errors: standard deviations count them."""

WELL = "verdict.well"
"""Code of the one diagnostic of a verdict without reservations."""


def verdict_of(
    estimates: Iterable[Estimate],
    posteriors: Collection[Posterior] = (),
    shown: str = POSTERIOR,
    doubts: Iterable[Diagnostic] = (),
) -> tuple[Diagnostic, ...]:
    """Verdict on estimates: reservations in order, or one line of prediction errors.

    Args:
        estimates: By least squares, of one recording.
        posteriors: With the model file as prior, of an imported recording.
        shown: The estimate that counts of a posterior: "posterior" or "plain".
        doubts: About the robot and the recording.
    """
    made = list(estimates)
    first = [
        replace(each, level="error") for each in doubts if each.code in OF_RECORDING
    ]
    found = [said for each in posteriors for said in _reservations(each, shown)]
    other = {each.method for each in posteriors if each.used and shown == POSTERIOR}
    found += [
        said
        for said in diagnostics_of(made)
        if said.level == "error"
        # of least squares
        and not (said.method in other and messages()[said.code].symptom)
    ]
    found += [
        said
        for each in made
        for said in each.diagnostics
        if said.code.startswith(MODEL_ERROR)
    ]
    if first or found:
        return ordered([*first, *found])
    if not posteriors:
        return tuple(
            _well(each.instrument, each.relative_residual, "fitted") for each in made
        )
    held_out = [(each.instrument, each.errors[0]) for each in posteriors]
    return tuple(_well(name, each.share(shown), each.of) for name, each in held_out)


def _well(instrument: str, share: Array, of: str) -> Diagnostic:
    """Line of prediction errors relative to the channels' signals, (C,)."""
    least, most = 100 * np.nanmin(share), 100 * np.nanmax(share)
    return diagnose("verdict.well", instrument, float(most), least=least, of=phrase(of))


def _reservations(found: Posterior, shown: str) -> Iterator[Diagnostic]:
    """Reservations: rivals that predict better, channels not predicted, a file without use."""
    yield from found.worse(shown)
    method, held_out = found.method, found.errors[0]
    left, signal, units = held_out.residual[shown], held_out.signal, held_out.units
    grave = matters(left, signal, units, THRESHOLDS.residual)
    for c, share in enumerate(held_out.share(shown).tolist()):
        label = channel_label(method, held_out.channels[c])
        if np.isnan(signal[c]):
            yield diagnose("verdict.few-rows", label, held_out.rows[c], method=method)
        elif share > THRESHOLDS.residual:
            yield diagnose(
                "verdict.residual",
                label,
                share,
                method=method,
                level="error" if grave[c] else None,
                causes=() if grave[c] else ("faint",),
                residual=left[c],
                signal=signal[c],
                unit=units[c],
            )
    yield from _episodes(found)
    if shown == POSTERIOR and found.used and found.prior_error > NOTHING:
        yield diagnose(
            "verdict.file", "the model file", found.prior_error, method=method
        )


def _episodes(found: Posterior) -> Iterator[Diagnostic]:
    """Channels whose residual in one interval is far above all other intervals'."""
    usual = np.median(found.by_part, axis=0)
    apart = (found.by_part > EPISODE * usual) & (usual > 0)
    ends = np.linspace(0.0, found.duration, len(found.by_part) + 1)
    for c in np.flatnonzero(
        (apart.sum(axis=0) > 0) & (apart.sum(axis=0) <= LONGEST)
    ).tolist():
        parts = np.flatnonzero(apart[:, c])
        most = float(found.by_part[parts, c].max())
        if (
            parts[-1] - parts[0] >= LONGEST
            or not most > FAINT * found.errors[0].signal[c]
        ):
            continue
        yield diagnose(
            "verdict.episode",
            channel_label(found.method, found.errors[0].channels[c]),
            most / max(float(usual[c]), TINY),
            method=found.method,
            begin=ends[parts[0]],
            end=ends[parts[-1] + 1],
            residual=most,
            unit=found.errors[0].units[c],
        )
