"""The verdict on estimates of a recording: what is wrong, the gravest first, or what shows it well.

Errors on held-out parts are its evidence, where there are some; else residuals.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics import Diagnostic, diagnose, ordered, phrase
from testbed.identification.diagnostics.diagnosis import UNEXPLAINED
from testbed.identification.diagnostics.residuals import diagnostics_of
from testbed.identification.estimate import Estimate, channel_label
from testbed.identification.posterior import Posterior
from testbed.identification.selection.linear_prior import MOST_ERROR
from testbed.identification.selection.prediction_errors import POSTERIOR, PredictionErrors

NOTHING = 1.0
"""Error of the model file's bodies, in parts of themselves, with which it says next to nothing."""

WELL = "verdict.well"
"""Code of the one diagnostic of a verdict without reservations."""

SAID_BY_PARTS = ("channel.residual",)
"""Codes of diagnostics for which held-out parts are the better witness."""


def verdict_of(
    estimates: Iterable[Estimate],
    posteriors: Collection[Posterior] = (),
    shown: str = POSTERIOR,
) -> tuple[Diagnostic, ...]:
    """What to know first of estimates: reservations in order, or one line with the evidence.

    Args:
        estimates: By least squares, of one recording.
        posteriors: With the model file as prior, of an imported recording.
        shown: The estimate that counts of a posterior: "posterior" or "plain".
    """
    made = list(estimates)
    found = [said for each in posteriors for said in _reservations(each, shown)]
    witnesses = {each.method for each in posteriors}
    found += [
        said
        for said in diagnostics_of(made)
        if said.level == "error" and not (said.method in witnesses and said.code in SAID_BY_PARTS)
    ]
    if found:
        return ordered(found)
    well = [_well(each.instrument, each.errors[0].share(shown), each.errors[0].of)
            for each in posteriors]  # fmt: skip
    return tuple(well) or tuple(_well(e.instrument, e.relative_residual, "fitted") for e in made)


def _well(instrument: str, share: Array, of: str) -> Diagnostic:
    """The evidence: errors in parts of the channels' signals, (C,)."""
    least, most = (100 * float(each(share)) for each in (np.nanmin, np.nanmax))
    return diagnose(WELL, instrument, most, least=least, of=phrase(of))


def _reservations(found: Posterior, shown: str) -> Iterator[Diagnostic]:
    """Rivals that predict better, large residuals, a file that says nothing, few rows."""
    yield from found.worse(shown)
    held_out = found.errors[0]
    yield from _large(held_out, shown)
    if shown == POSTERIOR and found.used and found.prior_error > NOTHING:
        yield diagnose(
            "verdict.file",
            "the bodies of the model file",
            found.prior_error,
            method=found.method,
            least="at least " * (found.prior_error >= MOST_ERROR),
        )
    few = np.isnan(held_out.signal)
    for c in np.flatnonzero(few).tolist():
        yield diagnose(
            "verdict.few-rows",
            channel_label(found.method, held_out.channels[c]),
            held_out.rows[c],
            method=found.method,
            level="error" if few.all() else None,
        )


def _large(held_out: PredictionErrors, shown: str) -> Iterator[Diagnostic]:
    """Channels of which a large part is not predicted; errors where like channels have no more."""
    units = np.array(held_out.units)
    for c, share in enumerate(held_out.share(shown).tolist()):
        if share > UNEXPLAINED:
            left = held_out.residual[shown][c]
            like = np.nanmax(held_out.signal[units == units[c]])
            yield diagnose(
                "verdict.residual",
                channel_label(held_out.method, held_out.channels[c]),
                share,
                method=held_out.method,
                level="error" if left > UNEXPLAINED * like else None,
                residual=left,
                signal=held_out.signal[c],
                unit=held_out.units[c],
            )
