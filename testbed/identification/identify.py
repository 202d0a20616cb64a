"""Identify the minimal parameters from a recording: the room's front door.

The external method reads encoders and plate, the internal one encoders and motor torques.
Neither sees the truth: the tree loses its masses and the recording its true columns here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from testbed.arrays import Array
from testbed.dynamics.dynamics import pedestal_wrench
from testbed.errors import RecordingError, UnknownName
from testbed.identification.covariance import hac_covariance
from testbed.identification.prepare import (
    Equations,
    Pipeline,
    external_equations,
    internal_equations,
)
from testbed.identification.solve import Solution, solve
from testbed.measurement.recording import Recording, check
from testbed.parameters.minimal_set import MinimalSet, minimal_set
from testbed.parameters.rules import Model
from testbed.tree.tree import Tree

Method = Literal["external", "internal"]

SIGNIFICANT = 0.3
"""Relative sigma above which a parameter is reported as poorly determined."""

ILL_CONDITIONED = 1e3
"""Condition of the scaled equations above which the estimate is reported as doubtful."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What one method found.

    Attributes:
        method: "external" (bedplate) or "internal" (joint torques).
        names: Minimal parameters, delta_r or delta_d; then, for the internal method,
            `coulomb/JOINT` and `viscous/JOINT`.
        units: One each.
        values: (p,).
        sigma: Standard deviations, (p,), correlation of residuals counted.
        covariance: (p, p).
        count: How many of the names are minimal parameters; they come first.
        matrix: Those on the 10 n barycentric parameters, (count, 10 n).
        channels: The measured channels.
        residual: Rms of their residuals, (channels,) [N, N m].
        relative_residual: ||y - phi delta|| / ||y|| of each, (channels,).
        samples: Rows used of each, (channels,).
        condition: Of the equations with unit columns and weights.
        rank: Their numerical rank.
        doubts: What a careful reader should know, one line each.
    """

    method: Method
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    covariance: Array
    count: int
    matrix: Array
    channels: tuple[str, ...]
    residual: Array
    relative_residual: Array
    samples: tuple[int, ...]
    condition: float
    rank: int
    doubts: tuple[str, ...]


def identify(
    tree: Tree,
    recording: Recording,
    method: Method = "external",
    *,
    zeros: bool = False,
    gravity: ArrayLike | None = None,
    pipeline: Pipeline | None = None,
) -> Estimate:
    """Minimal parameters from encoder positions and one kind of force measurement.

    Args:
        tree: The robot; its inertias are not used, except for `zeros`.
        recording: Columns are matched by joint name; its truth is not read.
        method: "external": six reaction rows a sample, no friction columns. "internal":
            a row a joint, with Coulomb and viscous columns.
        zeros: Take barycentric parameters that are zero in the model file as known.
        gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else
            the model file's.
        pipeline: How the signals are treated; default `Pipeline()`.

    Raises:
        RecordingError: The recording is of another robot, too short, or holds what is no
            measurement.
        UnseenParameters: The data cannot tell some parameters apart; names them.
    """
    if method not in ("external", "internal"):
        raise UnknownName("method", method, ("external", "internal"))
    check(recording, "the recording")
    pipeline = pipeline or Pipeline()
    gravity = recording.facts.get("gravity") if gravity is None else gravity
    model: Model = "reaction" if method == "external" else "dynamic"
    minimal = minimal_set(tree, model, gravity, zeros)
    geometry, data = tree.unweighed(), recording.blind().ordered(tree)
    doubts = list(recording.facts.get("doubts", ()))
    if data.tare is None:
        data = replace(data, tare=pedestal_wrench(geometry, gravity))
        if method == "external" and data.tare is not None and data.tare.any():
            doubts.append(
                "the recording does not say what of the wrench is the pedestal's; the model's "
                f"pedestal is taken off (Fz {data.tare[2]:.4g} N)"
            )
    if method == "internal":
        doubts += _rotors(tree)
    build = external_equations if method == "external" else internal_equations
    equations = build(geometry, data, minimal, pipeline)
    solution = solve(equations)
    covariance = hac_covariance(equations, solution)
    if not np.isfinite(covariance).all():
        raise RecordingError("the recording holds numbers too large to compute with")
    estimate = _estimate(method, geometry, minimal, equations, solution, covariance)
    return replace(estimate, doubts=(*doubts, *estimate.doubts))


def _rotors(tree: Tree) -> list[str]:
    """Joints whose drive has inertia of its own, which joint torques contain."""
    return [
        f"joint '{joint.name}' has a rotor inertia of {joint.rotor_inertia:g} kg m^2 or kg at the "
        "joint, which the internal estimate takes for the robot's"
        for joint in tree.joints
        if joint.rotor_inertia
    ]


def _estimate(
    method: Method,
    tree: Tree,
    minimal: MinimalSet,
    equations: Equations,
    solution: Solution,
    covariance: Array,
) -> Estimate:
    friction_units: tuple[str, ...] = ()
    if method == "internal":
        turns = [joint.revolute for joint in tree.joints]
        friction_units = (
            *("N m" if turn else "N" for turn in turns),
            *("N m s/rad" if turn else "N s/m" for turn in turns),
        )
    used = [
        (c.measured[c.used], r[c.used])
        for c, r in zip(equations.channels, solution.residuals, strict=True)
    ]
    sigma = np.sqrt(np.diagonal(covariance))
    return Estimate(
        method=method,
        names=equations.unknowns,
        units=(*minimal.units, *friction_units),
        values=solution.values,
        sigma=sigma,
        covariance=covariance,
        count=minimal.count,
        matrix=minimal.matrix,
        channels=tuple(channel.name for channel in equations.channels),
        residual=np.array([np.sqrt(np.mean(r**2)) for _, r in used]),
        relative_residual=np.array(
            [np.linalg.norm(r) / (np.linalg.norm(y) or 1.0) for y, r in used]
        ),
        samples=tuple(len(r) for _, r in used),
        condition=solution.condition,
        rank=solution.rank,
        doubts=_doubts(method, equations, solution, sigma),
    )


def _doubts(
    method: Method, equations: Equations, solution: Solution, sigma: Array
) -> tuple[str, ...]:
    doubts = []
    if solution.condition > ILL_CONDITIONED:
        doubts.append(
            f"the {method} equations are ill-conditioned ({solution.condition:.1e}): errors of the "
            "instrument grow by up to that factor"
        )
    loose = [
        f"{name} ({value:.3g} +- {s:.2g})"
        for name, value, s in zip(equations.unknowns, solution.values, sigma, strict=True)
        if s > SIGNIFICANT * abs(value) and not name.startswith(("coulomb/", "viscous/"))
    ]
    if loose:
        doubts.append(f"the {method} estimate leaves poorly determined: {', '.join(loose)}")
    return tuple(doubts)
