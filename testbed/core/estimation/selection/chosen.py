"""Settings with the terms and filters that estimates chose from their data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.settings import USUAL, Settings


def with_chosen_settings(settings: Settings, estimates: Iterable[Estimate]) -> Settings:
    """Settings that say what the data of estimates chose, where they left it open.

    Args:
        settings: Those by which the estimates were made.
        estimates: By one method or by both.
    """
    for each in estimates:
        used = each.settings
        if each.drives is not None and (
            settings.terms is not None or used.terms != USUAL
        ):
            settings = replace(settings, terms=used.terms)
        if any(diagnostic.code == "encoder.filter" for diagnostic in each.diagnostics):
            settings = replace(settings, position_cutoff=used.position_cutoff)
    return settings
