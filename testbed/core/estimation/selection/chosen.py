"""Settings with the terms and filters that were chosen from data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.settings import DEFAULT_TERMS, Settings


def completed_by_estimates(
    settings: Settings, estimates: Iterable[Estimate]
) -> Settings:
    """Settings completed by the terms and filters chosen from the data of estimates.

    Terms are taken from the estimate by joint torques, and the cutoff on positions from an estimate
    with the diagnostic "encoder.filter".

    Args:
        settings: Settings of the estimates as requested.
        estimates: Estimates by one method or by both.
    """
    for estimate in estimates:
        chosen_settings = estimate.settings
        if estimate.drives is not None and (
            settings.terms is not None or chosen_settings.terms != DEFAULT_TERMS
        ):
            settings = replace(settings, terms=chosen_settings.terms)
        if any(
            diagnostic.code == "encoder.filter" for diagnostic in estimate.diagnostics
        ):
            settings = replace(
                settings, position_cutoff=chosen_settings.position_cutoff
            )
    return settings
