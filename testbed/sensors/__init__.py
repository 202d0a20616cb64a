"""Errors of sensors: each simulated, estimated and taken back."""

from __future__ import annotations
