"""Every command, and the application that knows them."""

from __future__ import annotations

from testbed.cli import (
    calibrations,
    excitations,
    experiments,
    identifications,
    importing,
    models,
    pictures,
    starting,
    tools,
)
from testbed.cli.options import app

__all__ = [
    "app",
    "calibrations",
    "excitations",
    "experiments",
    "identifications",
    "importing",
    "models",
    "pictures",
    "starting",
    "tools",
]
