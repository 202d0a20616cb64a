"""Plates that mix their channels, and payloads that they weigh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import testbed as tb
from testbed.core.base.arrays import Array

BIAS = np.array([2.0, -1.0, 1.0, 0.3, 0.2, -0.1])
SCALE = np.array([500.0, 500.0, 1000.0, 200.0, 200.0, 100.0])
LOAD = tb.Inertia.about_centre(1.2, [0.03, -0.05, 0.2], np.diag([2e-3, 3e-3, 4e-3]))


def mixing(seed: int) -> Array:
    """1 % of full scale from channel to channel, gains off by 0.5 %."""
    rng = np.random.default_rng(seed)
    own = np.diag(1 + rng.uniform(-0.005, 0.005, 6))
    others = rng.uniform(-0.01, 0.01, (6, 6)) * (1 - np.eye(6))
    return np.asarray(own + others * SCALE[:, None] / SCALE)


def on_plate(recording: tb.Recording, matrix: Array) -> tb.Recording:
    """As a plate with a matrix and a zero shows it."""
    return replace(recording, wrench=recording.measured("wrench") @ matrix.T + BIAS)


def mass_of(tree: tb.Tree) -> float:
    """Of all moving bodies [kg]."""
    return sum(inertia.mass for inertia in tree.inertias)


def loaded(tree: tb.Tree, link: int = -1) -> tb.Tree:
    """With LOAD on a link."""
    return tree.with_inertia(link % tree.n, LOAD)
