"""Linear equality constraints for prior knowledge: total mass, centre of mass, any unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.dynamics.newton_euler import Motion, parameter_regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.robot.tree import Tree

TOTAL_MASS = "mass"
"""Name of the total mass of all moving bodies on the plate [kg]."""

CENTRE_OF_MASS_PREFIX = "centre/"
"""Prefix of the names of coordinates of the centre of mass in the bedplate frame [m]: centre/x with
all joints at zero, centre/x@elbow=1.57 with the elbow at 1.57."""

_STATIC_MOMENTS = {"x": (2, 4, -1.0), "y": (2, 3, 1.0), "z": (0, 4, 1.0)}
"""Measurement of the first moment along each axis: axis of unit gravity (negative direction),
channel of the wrench, and sign of the moment there."""


def total_mass(tree: Tree, minimal: MinimalSet) -> Array:
    """Coefficients of the minimal parameters that give the total moving mass, (N,) [kg].

    Args:
        tree: Robot.
        minimal: Minimal set.

    Raises:
        SettingsError: The minimal parameters do not determine the total mass.
    """
    return _minimal_combination(
        minimal, _static_wrench_regressor(tree, np.zeros(tree.n), 2)[2], TOTAL_MASS
    )


def centre_of_mass(tree: Tree, minimal: MinimalSet, name: str, value: float) -> Array:
    """Coefficients of a combination that is zero for the given centre of mass, (N,) [kg m].

    The combination is `moment - value * mass`, with the bodies' first moment and total mass.

    Args:
        tree: Robot.
        minimal: Minimal set.
        name: Name of the coordinate, such as "centre/x" or "centre/x@elbow=1.57,waist=0.3".
        value: Coordinate of the centre of mass [m].

    Raises:
        UnknownName: The axis or a joint does not exist.
        SettingsError: The posture is malformed, or the minimal parameters do not determine the
            moment.
    """
    axis, _, posture = name.removeprefix(CENTRE_OF_MASS_PREFIX).partition("@")
    if axis not in _STATIC_MOMENTS:
        raise UnknownName(
            "known fact",
            name,
            [f"{CENTRE_OF_MASS_PREFIX}{each}" for each in _STATIC_MOMENTS],
        )
    gravity_axis, channel, sign = _STATIC_MOMENTS[axis]
    moment = (
        sign
        * _static_wrench_regressor(
            tree, _posture_positions(tree, name, posture), gravity_axis
        )[channel]
    )
    return _minimal_combination(minimal, moment, name) - value * total_mass(
        tree, minimal
    )


def _posture_positions(tree: Tree, name: str, posture: str) -> Array:
    """Parse joint positions such as elbow=1.57,waist=0.3; zero by default, (n,).

    Args:
        tree: Robot.
        name: Full name, for the error message.
        posture: Text of the joint positions [rad or m]; "" for all zero.

    Raises:
        UnknownName: A joint does not exist.
        SettingsError: A position is no finite number.
    """
    q = np.zeros(tree.n)
    for word in filter(None, posture.split(",")):
        joint, _, number = word.rpartition("=")
        try:
            q[tree.index(joint)] = float(number)
        except ValueError:
            q[:] = np.nan
        if not np.isfinite(q).all():
            raise SettingsError(
                f"'{name}': write a posture as {CENTRE_OF_MASS_PREFIX}x@{tree.names[-1]}=1.57"
            )
    return q


def _static_wrench_regressor(tree: Tree, q: Array, gravity_axis: int) -> Array:
    """Static wrench per unit of each barycentric parameter under unit gravity, (6, 10 n).

    Args:
        tree: Robot.
        q: Joint positions, (n,).
        gravity_axis: Index of the axis along whose negative direction gravity of 1 m/s^2 acts.
    """
    gravity = -np.eye(3)[gravity_axis]
    return np.asarray(
        parameter_regressor(tree, Motion.at_rest(q[None]), "wrench", gravity)[0]
    )


def _minimal_combination(minimal: MinimalSet, functional: Array, name: str) -> Array:
    """Linear functional of the barycentric parameters in terms of the minimal parameters, (N,).

    Args:
        minimal: Minimal set.
        functional: Coefficients of the barycentric parameters, (10 n,).
        name: Name of the functional, for the error message.

    Raises:
        SettingsError: The minimal parameters do not determine the functional.
    """
    functional = np.where(minimal.known_zero.ravel(), 0.0, functional)
    combination = functional @ minimal.lift
    # relative part of a functional outside the span of the minimal parameters, by rounding
    if np.abs(combination @ minimal.matrix - functional).max() > 1e-9 * np.abs(
        functional
    ).max(initial=1.0):
        raise SettingsError(
            f"'{name}' is not identifiable from this recording: "
            + (
                "it needs the plate, and its weight without tare"
                if name == TOTAL_MASS
                else "its motion does not change with it; measure it along another axis, or in "
                "another posture"
            )
        )
    return combination


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """Linear constraints on unknowns x with uncertain right-hand sides: rows x = values.

    Attributes:
        names: Names of the known quantities.
        rows: Coefficients, (k, m).
        values: Right-hand sides, (k,).
        root: Square root R of the covariance R R' of the values, (k, r), for a scale factor of one.
        scale: Coefficients of the unknowns in the scale factor of `root`, (k, m): the mass for a
            centre of mass; zeros for a factor of one.
        present_scale: Scale factor at the current unknowns, (k,).
    """

    names: tuple[str, ...]
    rows: Array
    values: Array
    root: Array
    scale: Array
    present_scale: Array

    def __len__(self) -> int:
        """Number of constraints."""
        return len(self.names)

    def restricted_to(self, unknowns: Sequence[int]) -> LinearConstraints:
        """Constraints on a subset of the unknowns, with the other unknowns set to zero.

        Args:
            unknowns: Indices of the unknowns of the subset.
        """
        return replace(self, rows=self.rows[:, unknowns], scale=self.scale[:, unknowns])

    def on_corrections(self, unknowns: Array) -> LinearConstraints:
        """Constraints on corrections of the current unknowns.

        Args:
            unknowns: Current unknowns, (m,).
        """
        reached = self.present_scale + self.scale @ unknowns
        return replace(
            self, values=self.values - self.rows @ unknowns, present_scale=reached
        )

    def covariance_root(self, added: Array) -> Array:
        """Square root of the covariance of the values after a correction, (k, r).

        Args:
            added: Correction of the current unknowns, (m,).
        """
        magnitude = np.abs(self.present_scale + self.scale @ added)
        return np.where(self.scale.any(axis=1), magnitude, 1.0)[:, None] * self.root


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Solutions `x = right_inverse @ values + basis @ z` of linear constraints for free unknowns z.

    Attributes:
        basis: Null-space basis, (m, m - k).
        right_inverse: Right inverse of the constraint matrix, (m, k).
    """

    basis: Array
    right_inverse: Array


def known_value_constraints(
    tree: Tree,
    minimal: MinimalSet,
    names: Sequence[str],
    sensor_names: Sequence[str],
    known: Mapping[str, tuple[float, float]],
) -> LinearConstraints:
    """Linear constraints for known values of a robot's unknowns and sensor coefficients.

    A known centre of mass becomes the constraint `moment - value * mass = 0`, whose sigma is
    proportional to the mass.

    Args:
        tree: Robot.
        minimal: Minimal set.
        names: Names of the robot's unknowns, minimal parameters first.
        sensor_names: Names of the coefficients of sensor errors, which follow.
        known: Value and sigma by name: "mass" [kg], "centre/x" [m], a minimal parameter, or a
            coefficient.

    Raises:
        UnknownName: A name is neither an unknown nor a known quantity.
        SettingsError: The minimal parameters do not determine a quantity.
    """
    unknowns = (*names, *sensor_names)
    rows, scale = (np.zeros((len(known), len(unknowns))) for _ in range(2))
    values, sigmas = np.array(list(known.values())).reshape(-1, 2).T
    for k, name in enumerate(known):
        if name == TOTAL_MASS:
            rows[k, : minimal.count] = total_mass(tree, minimal)
        elif name.startswith(CENTRE_OF_MASS_PREFIX):
            row = centre_of_mass(tree, minimal, name, float(values[k]))
            rows[k, : minimal.count], values[k] = row, 0.0
            scale[k, : minimal.count] = total_mass(tree, minimal)
        elif name in unknowns:
            rows[k, unknowns.index(name)] = 1.0
        else:
            raise UnknownName(
                "known fact", name, (TOTAL_MASS, f"{CENTRE_OF_MASS_PREFIX}x", *unknowns)
            )
    return LinearConstraints(
        tuple(known), rows, values, np.diag(sigmas), scale, np.zeros(len(known))
    )


def free(constraints: LinearConstraints) -> NullSpace:
    """Null space of linear constraints from Gauss-Jordan elimination with the largest pivots.

    Args:
        constraints: Linear constraints.

    Raises:
        SettingsError: A constraint follows from the others.
    """
    count, size = constraints.rows.shape
    rows, solution = constraints.rows.copy(), np.eye(count)
    pivots: list[int] = []
    for k in range(count):
        pivot = int(np.abs(rows[k]).argmax())
        # relative part of a row that is independent of the rows before, by rounding
        if abs(rows[k, pivot]) <= 1e-9 * np.abs(constraints.rows[k]).max():
            raise SettingsError(
                f"'{constraints.names[k]}' is known twice: it follows from "
                f"{', '.join(constraints.names[:k])}"
            )
        solution[k] /= rows[k, pivot]
        rows[k] /= rows[k, pivot]
        others = np.arange(count) != k
        solution[others] -= np.outer(rows[others, pivot], solution[k])
        rows[others] -= np.outer(rows[others, pivot], rows[k])
        pivots.append(pivot)
    free_unknowns = [m for m in range(size) if m not in pivots]
    basis, fixed = np.zeros((size, len(free_unknowns))), np.zeros((size, count))
    basis[free_unknowns, range(len(free_unknowns))] = 1.0
    basis[pivots] = -rows[:, free_unknowns]
    fixed[pivots] = solution
    return NullSpace(basis, fixed)
