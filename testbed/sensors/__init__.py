"""Sensor errors: simulation, estimation of their coefficients, correction of recordings."""

from __future__ import annotations
