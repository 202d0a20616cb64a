"""What a report says, as plain data: for the page, and as JSON beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.identification.estimate import Estimate, Method
from testbed.identification.filters import row_weights
from testbed.identification.predict import (
    friction,
    motion_in,
    predictions,
)
from testbed.identification.settings import Settings
from testbed.recordings.columns import AXES
from testbed.recordings.recording import Recording
from testbed.report.tables import with_sigma
from testbed.robot.tree import Tree

CLOSE = 0.9
"""Correlation above which two parameters are told apart poorly."""
MOST_PAIRS = 5
"""Pairs that are named."""
FAR = 5.0
"""Errors in sigmas that noise does not make."""
EXACT = 1e-6
"""Relative error below which a sigma of nearly zero is of no matter."""
CUTOFF = 10.0
"""Of the low-pass on signals that are drawn [Hz]."""
UNITS = ("N", "N", "N", "N m", "N m", "N m")


@dataclass(frozen=True, eq=False)
class Subject:
    """What a report is about.

    Attributes:
        title: Its name.
        tree: The robot.
        recording: What was measured.
        unseen: Another recording, of a motion that no estimate has seen; None for none.
        external: Estimate from the plate.
        internal: Estimate from the motor torques.
        truths: True values by name; empty where they are not known.
        claim: What the experiment shows.
        verdicts: Claims with what came out: name, wanted, value, holds.
        asked: Facts on model, instrument and motion, in order.
        settings: How the estimates treated the recording.
        origin: Facts on files, versions and how to repeat it, in order.
        warnings: What a careful reader should know.
    """

    title: str
    tree: Tree
    recording: Recording
    unseen: Recording | None
    external: Estimate
    internal: Estimate
    truths: Mapping[str, float] = field(default_factory=dict)
    claim: str = ""
    verdicts: Sequence[Mapping[str, Any]] = ()
    asked: Sequence[tuple[str, str]] = ()
    settings: Settings = field(default_factory=Settings)
    origin: Sequence[tuple[str, str]] = ()
    warnings: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Check:
    """Measured against predicted on one recording.

    Attributes:
        time: (M,) [s].
        rate: Samples a second [Hz].
        speed: Joint velocities, (M, n).
        channels: Names of the plate's channels and of the joints.
        units: One a channel.
        measured: (M, 6 + n).
        external: Predicted by the external estimate; joint torques lack friction, (M, 6 + n).
        internal: Predicted by the internal estimate, which takes from the external one what
            joint torques cannot tell, (M, 6 + n).
    """

    time: Array
    rate: float
    speed: Array
    channels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Array
    external: Array
    internal: Array

    def smooth(self) -> Check:
        """All signals through one low-pass, as the identification's rows pass it."""
        weights = row_weights(self.rate, CUTOFF)
        reach = len(weights) // 2

        def filtered(signals: Array) -> Array:
            return np.column_stack([np.convolve(s, weights, "valid") for s in signals.T])

        inner = slice(reach, len(self.time) - reach)
        signals: dict[str, Any] = {
            k: filtered(getattr(self, k)) for k in ("measured", "external", "internal")
        }
        return replace(self, time=self.time[inner], speed=self.speed[inner], **signals)

    def relative(self, predicted: Array) -> Array:
        """Rms of the residual over rms of the measured signal about its mean, per channel."""
        rest = np.sqrt(np.mean((self.measured - predicted) ** 2, axis=0))
        return np.asarray(rest / np.maximum(self.measured.std(axis=0), 1e-300))


def check(subject: Subject) -> Check:
    """Predictions for the unseen recording, or for the one that was identified."""
    tree = subject.tree
    recording = subject.unseen or subject.recording
    recording = recording if recording.names == tree.names else recording.ordered(tree)
    motion, inner = motion_in(recording, subject.settings)
    estimates: dict[Method, Estimate] = {"external": subject.external, "internal": subject.internal}
    wrench, torque = predictions(tree, recording, motion, estimates)
    pairs = [np.hstack([wrench[method], torque[method]]) for method in estimates]
    units = tuple("N m" if joint.revolute else "N" for joint in tree.joints)
    measured = np.hstack([recording.measured("wrench")[inner], recording.measured("torque")[inner]])
    channels = (*AXES, *tree.names)
    units = (*UNITS, *units)
    return Check(motion.t, recording.rate, motion.qd, channels, units, measured, *pairs)


def friction_points(subject: Subject, found: Check) -> tuple[Array, Array]:
    """Torque that the plate's estimate leaves unexplained, and what the torques' friction says."""
    rest = found.measured[:, 6:] - found.external[:, 6:]
    return rest, friction(found.speed, subject.internal)


def parameter_rows(subject: Subject) -> list[dict[str, Any]]:
    """The Table-6-like table: every parameter, by both methods."""
    estimates = (subject.external, subject.internal)
    internal = subject.internal
    names = dict.fromkeys((*internal.base.names, *subject.external.names))
    units = {n: u for e in estimates for n, u in zip(e.names, e.units, strict=True)}
    rows = []
    for name in (*names, *(term.name for term in internal.joint_terms)):
        truth = subject.truths.get(name)
        rows.append(
            {
                "name": name,
                "unit": units[name],
                "truth": "" if truth is None else f"{truth:.6g}",
                "cells": [_cell(estimate, name, truth) for estimate in estimates],
            }
        )
    return rows


def _cell(estimate: Estimate, name: str, truth: float | None) -> dict[str, Any]:
    cell: dict[str, Any] = {
        "method": estimate.method,
        "text": with_sigma(estimate, name),
        "z": None,
    }
    if truth is not None and name in estimate.names:
        k = estimate.names.index(name)
        sigma = float(estimate.sigma[k])
        z = (float(estimate.values[k]) - truth) / sigma if sigma > 0 else 0.0
        share = min(abs(z), 5.0) * 10.0
        left = 50.0 if z > 0 else 50.0 - share
        cell |= {"z": z, "shown": f"{z:+.1f}", "left": round(left, 1), "width": round(share, 1)}
    return cell


def notes(subject: Subject) -> list[str]:
    """Doubts, and pairs of parameters that the data tell apart poorly, in words."""
    found = list(dict.fromkeys(subject.warnings))
    for estimate in (subject.external, subject.internal):
        found += _close_pairs(estimate) + _systematic(estimate, subject.truths)
    return found


def _systematic(estimate: Estimate, truths: Mapping[str, float]) -> list[str]:
    """Errors that no sigma explains, where the truth is known."""
    off = {
        name: abs(value - truths[name]) / sigma
        for name, value, sigma in zip(estimate.names, estimate.values, estimate.sigma, strict=True)
        if name in truths and abs(value - truths[name]) > FAR * sigma + EXACT * abs(value)
    }
    if not off:
        return []
    worst = max(off, key=off.__getitem__)
    return [
        f"the {estimate.method} estimate of {len(off)} parameters is off by more than {FAR:g} "
        f"sigma, {worst} by {off[worst]:.0f}: its errors are systematic, such as a wrong torque "
        "constant, friction of another law or an unmodelled rotor, and sigma does not tell them"
    ]


def _close_pairs(estimate: Estimate) -> list[str]:
    scale = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 1e-300))
    correlation = estimate.covariance / np.outer(scale, scale)
    pairs = np.argwhere(np.triu(np.abs(correlation) > CLOSE, 1))
    worst = sorted(pairs.tolist(), key=lambda p: -abs(correlation[p[0], p[1]]))
    said = [
        f"{estimate.names[a]} and {estimate.names[b]} are told apart poorly by the "
        f"{estimate.method} method: their correlation is {correlation[a, b]:.2f}"
        for a, b in worst[:MOST_PAIRS]
    ]
    if len(worst) > MOST_PAIRS:
        more = len(worst) - MOST_PAIRS
        said.append(f"so are {more} more pairs, by the {estimate.method} method, less")
    return said
