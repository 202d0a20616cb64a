"""Every command, and the application that knows them."""

from __future__ import annotations

from testbed.cli import experiments, models, pictures, plates
from testbed.cli.options import app

__all__ = ["app", "experiments", "models", "pictures", "plates"]
