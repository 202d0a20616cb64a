"""Modules of all commands, and the application with the registered commands."""

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
