"""The judge: estimates against the truth in the model file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.experiment.accuracy import Accuracy, accuracies
from testbed.identification.estimate import Estimate, Method
from testbed.parameters.barycentric import barycentric
from testbed.parameters.minimal_set import minimal_set, selection
from testbed.robot.friction import term_torque
from testbed.robot.transmission import shares
from testbed.robot.tree import Tree

SMALL = 0.01
"""A parameter below this share of the largest of its unit is small: its error is relative to that
share."""

FAINT = 0.1
"""A joint's term that makes less than this share of the joint's rms torque is faint: its error is
relative to that share."""

NOTHING = 1e-12
"""A unit whose true values are all below this share of the largest of any unit has no scale."""


@dataclass(frozen=True, eq=False)
class Errors:
    """One estimate's errors.

    Attributes:
        names: Of the parameters, (p,), as the estimate has them.
        truth: (p,).
        scale: (p,); not a number where there is none. Of a minimal parameter, abs(truth), or 1 %
            of the largest true value of the same unit if that is more; of a joint's term,
            abs(truth), or what makes 10 % of the joint's rms torque.
        relative: Errors over their scales, (p,).
        z: (estimate - truth) / sigma, (p,); this and `relative` are not numbers where a value is
            not identifiable.
    """

    names: tuple[str, ...]
    truth: Array
    scale: Array
    relative: Array
    z: Array


@dataclass(frozen=True, eq=False)
class Score:
    """A run's estimates against the truth.

    Attributes:
        errors: By method: of delta_r, and of delta_d with friction.
        metrics: What `[expect]` can bound, by name (docs/experiments.md). Those of a method
            without estimate, and those for which the robot has no scale, are absent.
        accuracy: By method, in a few numbers.
    """

    errors: Mapping[Method, Errors]
    metrics: Mapping[str, float]
    accuracy: Mapping[Method, Accuracy]

    @property
    def truths(self) -> dict[str, float]:
        """True values by parameter name."""
        return {
            name: value
            for errors in self.errors.values()
            for name, value in zip(errors.names, errors.truth.tolist(), strict=True)
        }


def score(
    tree: Tree,
    estimates: Mapping[Method, Estimate],
    zeros: bool | Sequence[str],
    friction: bool,
    motion: Motion,
    torque: Array | None,
) -> Score:
    """Compare the estimates of one run with the truth.

    Relative rms errors are over delta_d, which both methods know: the external one's is
    S delta_r.

    Args:
        tree: The robot with its true inertias and friction, under the recording's gravity.
        estimates: By method.
        zeros: Which zeros were taken as known, as in `minimal_set`.
        friction: Whether the plant had the file's friction.
        motion: That was identified, M samples.
        torque: Motor torques along it, (M, n) [N m or N]; None where there are none.
    """
    errors = {
        method: _errors(estimate, _truth(tree, estimate, friction), motion, torque)
        for method, estimate in estimates.items()
    }
    metrics: dict[str, float | None] = {}
    if "external" in errors:
        metrics |= _inertial("external", errors, estimates)
        shared = shared_errors(tree, estimates["external"].base.values, zeros)
        metrics["external_rms_relative_error"] = root_mean_square(shared)
    if "internal" in errors:
        metrics |= _inertial("internal", errors, estimates)
        count = estimates["internal"].minimal.count
        metrics["internal_rms_relative_error"] = root_mean_square(
            errors["internal"].relative[:count]
        )
        terms = zip(
            estimates["internal"].joint_terms, errors["internal"].relative[count:], strict=True
        )
        resisting = np.array([error for term, error in terms if term.law.resists])
        metrics["friction_max_relative_error"] = _largest(resisting)
    ours, theirs = (metrics.get(f"{m}_rms_relative_error") for m in ("internal", "external"))
    if ours is not None and theirs is not None:
        metrics["internal_to_external"] = ours / max(theirs, np.finfo(float).tiny)
    known = {name: value for name, value in metrics.items() if value is not None}
    return Score(errors, known, accuracies(tree, estimates, zeros, motion))


def _truth(tree: Tree, estimate: Estimate, friction: bool) -> Array:
    """True values in the order of an estimate's names."""
    theta = barycentric(tree)
    if estimate.drives is None:
        return estimate.minimal.values(theta)
    return estimate.drives.values(theta, tree if friction else tree.without_friction())


def shared_errors(tree: Tree, values: Array, zeros: bool | Sequence[str]) -> Array:
    """Relative errors of delta_d by a plate's parameters.

    Args:
        tree: The robot with its true inertias, under the recording's gravity.
        values: delta_r, (N_r,).
        zeros: Which zeros were taken as known.
    """
    reaction, dynamic = (minimal_set(tree, model, zeros=zeros) for model in ("reaction", "dynamic"))
    known = selection(dynamic, reaction) @ values
    return relative_errors(known, dynamic.values(barycentric(tree)), dynamic.units)


def _inertial(
    method: Method, errors: Mapping[Method, Errors], estimates: Mapping[Method, Estimate]
) -> dict[str, float | None]:
    """Metrics over one method's own minimal parameters."""
    count = estimates[method].minimal.count
    return {
        f"{method}_max_relative_error": _largest(errors[method].relative[:count]),
        f"{method}_max_z": _largest(errors[method].z[:count]),
    }


def _errors(estimate: Estimate, truth: Array, motion: Motion, torque: Array | None) -> Errors:
    error = estimate.values - truth
    sigma = np.maximum(estimate.sigma, np.finfo(float).tiny)
    base, count = estimate.base, estimate.minimal.count
    scales = [_usual(truth[:count], base.units), *_of_terms(estimate, truth, motion, torque)]
    scale = np.concatenate(scales)
    error[np.isinf(sigma)] = np.nan
    return Errors(estimate.names, truth, scale, error / scale, error / sigma)


def _of_terms(
    estimate: Estimate, truth: Array, motion: Motion, torque: Array | None
) -> Iterator[Array]:
    """Scales of the joints' terms, (1,) each: what would make a small part of the torque."""
    if estimate.drives is None:
        return
    tree, terms = estimate.drives.tree, estimate.drives.terms
    for term, true in zip(terms, truth[estimate.minimal.count :], strict=True):
        columns = term_torque(tree, term, motion.qd, motion.qdd)
        j = int(np.argmax(np.abs(shares(tree)[term.joint])))
        column = columns[:, j]
        makes, all_of_it = _root_mean_square(column), 0.0
        if torque is not None and makes > 0:
            all_of_it = _root_mean_square(torque[:, j]) / makes
        scale = max(abs(float(true)), FAINT * all_of_it)
        yield np.array([scale if scale > 0 else np.nan])


def _usual(truth: Array, units: Sequence[str]) -> Array:
    """Scales of minimal parameters, (p,); not a number where all of a unit are zero."""
    scale = np.abs(truth)
    least = NOTHING * scale.max(initial=0.0)
    for unit in set(units):
        same = np.array([u == unit for u in units])
        largest = scale[same].max()
        scale[same] = np.maximum(scale[same], SMALL * largest) if largest > least else np.nan
    return scale


def relative_errors(values: Array, truth: Array, units: Sequence[str]) -> Array:
    """Errors of minimal parameters over their scales, (..., p), as in `Errors.relative`.

    Args:
        values: (..., p).
        truth: (p,).
        units: (p,).
    """
    relative: Array = (values - truth) / _usual(truth, units)
    return relative


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def root_mean_square(errors: Array) -> float | None:
    """Of those errors that are numbers; None without any.

    Args:
        errors: Some of them not numbers, where there is no scale.
    """
    there = errors[np.isfinite(errors)]
    return _root_mean_square(there) if there.size else None


def _largest(errors: Array) -> float | None:
    there = np.abs(errors[~np.isnan(errors)])
    return float(there.max()) if there.size else None
