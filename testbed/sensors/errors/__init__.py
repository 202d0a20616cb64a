"""Errors of sensors, one a module; `testbed.sensors.catalogue` finds them."""

from __future__ import annotations
