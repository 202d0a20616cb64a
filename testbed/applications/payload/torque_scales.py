"""Scales of joint torques by a known payload: two recordings of one robot, without it and with it.

A drive reports k times its joint's torque. Bodies tie the joints' torques to one set of parameters,
and the known mass fixes what they leave open, one scale for all. Gauss-Newton on the products of
both recordings' rows; standard deviations by what these leave, as coloured noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from testbed.applications.payload.payload import SEEN, SMALLEST, seen_of_payload
from testbed.core.base.arrays import Array
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.base.gaussian import Gaussian
from testbed.core.base.stages import Progress, unreported
from testbed.core.estimation.noise.fits import weighted_fits
from testbed.core.estimation.noise.lagged_products import HIGHEST, LaggedSums
from testbed.core.estimation.noise.replicas import Replicas
from testbed.core.estimation.noise.whitening import counted
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    NormalEquations,
    inverse_and_solution,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.selection.term_choice import with_all_terms
from testbed.core.estimation.settings import DEFAULTS, Settings, with_sigmas
from testbed.core.recordings.source import RecordingLike
from testbed.core.robot.tree import Tree

STEPS = 10
"""Of Gauss and Newton, from scales of one."""

MASS = "payload/mass"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TorqueScales(Gaussian):
    """Reported over true torque, joint by joint: divide torques, or gains, by these.

    Attributes:
        known: Value and sigma of what was known of the payload, by name.
    """

    known: Mapping[str, tuple[float, float]]


class _Half(NamedTuple):
    """One recording: its unknowns are lead @ v + fixed."""

    passes: Passes
    equations: NormalEquations
    lead: Array
    fixed: Array

    def weights(self, x: Array, scales: Array) -> Array:
        """Of the channels, one over the mean square that unknowns, (p,), leave, (n,)."""
        found = []
        for j, k in enumerate(scales):
            normal, right, square = self.equations.of_channel(j)
            left = float(square - 2 * k * (right @ x) + k**2 * (x @ normal @ x))
            found.append(max(left, 1e-12 * square, TINY))
        return np.maximum(self.equations.used, 1.0) / found


def torque_scales(
    tree: Tree,
    without: RecordingLike,
    loaded: RecordingLike,
    known: Mapping[str, float | Sequence[float]],
    joint: str | None = None,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    threads: int | None = None,
    progress: Progress = unreported,
) -> TorqueScales:
    """Scales of joint torques, from a recording without a payload of known mass and one with it.

    Args:
        tree: The robot without the payload; its inertias are not used.
        without: The recording without it, as for `identify`; with torques.
        loaded: The one with it, along any other motion.
        known: "payload/mass": a value, or value and sigma [kg].
        joint: The payload is on the link that this one moves; default the last.
        gravity: (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: How the signals are treated, and the terms, which each recording has of its own.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: A recording cannot be used.
        SettingsError: The mass is not known, or does not fix the scale.
        UnknownName: Something else is known, or there is no such joint.
    """
    facts = with_sigmas(known)
    for name in facts.keys() - {MASS}:
        raise UnknownName("known fact", name, (MASS,))
    mass, doubt = facts.get(MASS, (0.0, 0.0))
    if mass <= 0:
        raise SettingsError(
            f"of the payload its mass has to be known, in kg: --known {MASS}=1.5"
        )
    settings = replace(settings, nuisances=(), known={})
    if settings.zeros:
        raise SettingsError(
            "a payload breaks the symmetry of links: calibrate without known zeros"
        )
    halves = []
    with one_blas_thread():
        for number, recording in enumerate((without, loaded)):
            problem, _ = with_all_terms(
                Problem.of(
                    tree,
                    recording,
                    "internal",
                    settings,
                    gravity=gravity,
                    threads=threads,
                    progress=progress,
                )
            )
            settings = replace(settings, terms=problem.settings.terms)
            halves.append(_half(problem, joint or tree.names[-1], mass, number))
        values, v = _solved(halves)
        covariance = _covariance(halves, values, v)
    # all else scales with the mass
    covariance += (doubt / mass) ** 2 * np.outer(values, values)
    return TorqueScales(
        names=tree.names,
        units=("",) * tree.n,
        values=values,
        covariance=covariance,
        known=facts,
    )


def _half(problem: Problem, joint: str, mass: float, number: int) -> _Half:
    """A recording's products; v are bodies, own terms of both, and the rest of the payload."""
    minimal = problem.minimal
    adds = seen_of_payload(problem.tree, minimal, joint)
    wide, sizes, _ = np.linalg.svd(adds[:, 1:], full_matrices=False)
    free = wide[:, sizes > SMALLEST * sizes[0]]
    fixed = mass * adds[:, 0]
    if np.linalg.norm(fixed - free @ (free.T @ fixed)) <= SEEN * np.linalg.norm(fixed):
        raise SettingsError(
            "the mass of the payload does not change the torques beside its unknown centre: let "
            "joints turn it against gravity"
        )
    passes = problem.passes(3)
    equations = problem.equations(passes)
    own = np.zeros((2, len(equations.unknowns) - minimal.count))
    own[number] = 1.0
    of_terms = np.hstack([np.diag(each) for each in own])
    lead = block_diag(np.eye(minimal.count), of_terms)
    rest = number * np.column_stack([fixed, free])
    rest = np.pad(rest, ((0, len(of_terms)), (0, 0)))
    return _Half(passes, equations, np.hstack([lead, rest[:, 1:]]), rest[:, 0])


def _solved(halves: Sequence[_Half]) -> tuple[Array, Array]:
    """Scales and v, by Gauss-Newton."""
    n, m = len(halves[0].equations.channels), halves[0].lead.shape[1]
    found = np.append(np.ones(n), np.zeros(m))
    for step in range(STEPS):
        at = slice(n if step == 0 else 0, None)  # the first finds v of scales of one
        matrix, vector = _normal(halves, found[:n], found[n:])
        found[at] += inverse_and_solution(matrix[at, at], vector[at])[1]
    return found[:n], found[n:]


def _normal(halves: Sequence[_Half], scales: Array, v: Array) -> tuple[Array, Array]:
    """J' W J and J' W r of what scales and v leave, each channel weighed by its own rest."""
    size = len(scales) + len(v)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    for half in halves:
        x = half.lead @ v + half.fixed
        for j, (k, weight) in enumerate(
            zip(scales, half.weights(x, scales), strict=True)
        ):
            normal, right, _ = half.equations.of_channel(j)
            rows = np.hstack([np.outer(x, np.eye(len(scales))[j]), k * half.lead])
            matrix += weight * rows.T @ normal @ rows
            vector += weight * rows.T @ (right - k * normal @ x)
    return matrix, vector


def _covariance(halves: Sequence[_Half], scales: Array, v: Array) -> Array:
    """Of the scales, (n, n), by the linearised rows of both recordings under coloured noise."""
    sums, n = LaggedSums(HIGHEST), len(scales)
    for half in halves:
        sums.pause()
        for rows in _linearised(half, scales, v):
            sums.add(rows)
    given = sums.finish()
    (fit,) = weighted_fits(given)
    replicas = Replicas(fit.noise)
    for half in halves:
        replicas.pause()
        for rows in _linearised(half, scales, v):
            replicas.add(rows[..., :-2], rows[..., -1])
    squares = replicas.squares(weighted_fits, np.eye(given.unknowns))
    return max(1.0, float(squares.mean())) * fit.covariance[:n, :n]


def _linearised(half: _Half, scales: Array, v: Array) -> Iterator[Array]:
    """Columns of scales and v, residuals, in units of noise, and ones, (C, k, n + m + 2)."""
    x, k = half.lead @ v + half.fixed, scales[:, None, None]
    root = np.sqrt(half.weights(x, scales))[:, None, None]
    for columns, measured in half.passes.rows(np.eye(len(x))):
        torque = (columns @ x)[..., None]
        by_scale = torque * np.eye(len(scales))[:, None]
        rows = [by_scale, k * columns @ half.lead, measured[..., None] - k * torque]
        ones = counted(columns, measured)[..., None]
        yield np.concatenate([*(root * each for each in rows), ones], axis=2)
