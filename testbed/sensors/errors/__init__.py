"""Sensor errors, one class per module, collected by `testbed.sensors.catalogue`."""

from __future__ import annotations
