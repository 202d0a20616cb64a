"""Estimates against the truth in the model file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.identification.estimate import Estimate
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import selection
from testbed.robot.tree import Tree

SMALL = 0.01
"""Errors of parameters below this share of the largest of their unit are taken relative to it."""


@dataclass(frozen=True, eq=False)
class Errors:
    """One estimate's errors.

    Attributes:
        truth: (p,), in the order of the estimate's names.
        relative: (estimate - truth) / |truth|, (p,).
        z: (estimate - truth) / sigma, (p,).
    """

    truth: Array
    relative: Array
    z: Array


@dataclass(frozen=True, eq=False)
class Comparison:
    """Both estimates against the truth.

    Attributes:
        external: Errors of delta_r.
        internal: Errors of delta_d, Coulomb and viscous friction.
        metrics: What `[expect]` can bound.
    """

    external: Errors
    internal: Errors
    metrics: Mapping[str, float]


def compare(tree: Tree, external: Estimate, internal: Estimate, friction: bool) -> Comparison:
    """Compare two estimates of one run with the truth.

    Relative rms errors are over delta_d, which both methods know: the external one's is
    S delta_r.

    Args:
        tree: The robot with its true inertias and friction.
        external: Estimate from the plate.
        internal: Estimate from the motor torques.
        friction: Whether the plant had the file's friction.
    """
    theta = barycentric(tree)
    dynamic, reaction = internal.minimal, external.minimal
    s = selection(dynamic, reaction)
    if internal.drives is None:
        raise ValueError("the internal estimate knows no drives")
    plant = tree if friction else tree.without_friction()
    outer = _errors(external, reaction.values(theta))
    inner = _errors(internal, internal.drives.values(theta, plant))
    shared = _relative(s @ external.base.values, dynamic.values(theta), dynamic.units)
    n = dynamic.count
    rms = {"external": _rms(shared), "internal": _rms(inner.relative[:n])}
    metrics = {
        "external_rms_relative_error": rms["external"],
        "external_max_relative_error": float(np.abs(outer.relative).max()),
        "external_max_z": float(np.abs(outer.z).max()),
        "internal_rms_relative_error": rms["internal"],
        "internal_max_relative_error": float(np.abs(inner.relative[:n]).max()),
        "internal_max_z": float(np.abs(inner.z[:n]).max()),
        "internal_to_external": rms["internal"] / max(rms["external"], np.finfo(float).tiny),
        "friction_max_relative_error": float(np.abs(inner.relative[n:]).max(initial=0.0)),
    }
    return Comparison(outer, inner, metrics)


def _errors(estimate: Estimate, truth: Array) -> Errors:
    error = estimate.values - truth
    sigma = np.maximum(estimate.sigma, np.finfo(float).tiny)
    return Errors(truth, _relative(estimate.values, truth, estimate.units), error / sigma)


def _relative(values: Array, truth: Array, units: tuple[str, ...]) -> Array:
    scale = np.abs(truth)
    for unit in set(units):
        same = np.array([u == unit for u in units])
        scale[same] = np.maximum(scale[same], SMALL * scale[same].max())
    scale[scale == 0] = 1.0
    relative: Array = (values - truth) / scale
    return relative


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
