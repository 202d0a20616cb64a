"""Every command, and the application that knows them."""

from __future__ import annotations

from testbed.cli import (
    calibrations,
    campaigns,
    excitations,
    experiments,
    identifications,
    importing,
    models,
    pictures,
    starting,
)
from testbed.cli.options import app

__all__ = [
    "app",
    "calibrations",
    "campaigns",
    "excitations",
    "experiments",
    "identifications",
    "importing",
    "models",
    "pictures",
    "starting",
]
