"""What files that vary one experiment have in common."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from testbed.experiment.experiment_tables import RunName, Table
from testbed.identification.estimate import METHODS, Method


class VariedTables(Table):
    """What a file says that varies one experiment: a comparison, a campaign."""

    name: RunName
    """Of the comparison or campaign."""
    claim: str = ""
    """What it shows, in a sentence."""
    experiment: str
    """Experiment file, relative to this one; its own claims do not count."""
    set: tuple[str, ...] = ()
    """What is different from it throughout: "key = value" as `--set` takes it."""
    methods: Annotated[tuple[Method, ...], Field(min_length=1)] = METHODS
    """Which estimates are made."""
