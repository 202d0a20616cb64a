"""Piecewise linear friction curves over velocity, and choice of friction laws.

A curve is linear between nodes, with a separate curve for each direction of motion. The torque at a
node is the coefficient of a friction law, so that it is estimated with the same filters, weights
and standard deviations as other laws.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from testbed.applications.drives.joint_regression import (
    JointRegression,
    TorqueRegressionData,
    fit_joint_regressions,
    torque_regression_data,
)
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import one_blas_thread
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.estimation.selection.folds import CrossProducts, Folds
from testbed.core.estimation.selection.held_out import (
    BASE_LAWS,
    CANDIDATE_LAWS,
    SelectionStep,
    are_exclusive,
    forward_selection,
)
from testbed.core.robot.friction import (
    DRIFT_LAWS,
    LOAD_LAWS,
    LOAD_MULTIPLIERS,
    ROTOR,
    STRIBECK_KIND,
)
from testbed.core.robot.joint_law import JointLaw
from testbed.core.robot.tree import Tree

NODES = (
    0,
    0.03,
    0.06,
    0.1,
    0.15,
    0.2,
    0.3,
    0.45,
    0.7,
    1,
    1.4,
    2,
    2.8,
    4,
    5.6,
    8,
    11,
    16,
)
"""Speeds of the nodes, dense where friction changes most [rad/s or m/s]."""

MIN_ROWS = 4.0
"""Smallest effective number of rows for a node, and for Stribeck friction."""


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """Friction of one joint as a function of velocity, linear between nodes.

    Attributes:
        joint: Name of the joint.
        speed: Velocities of the m nodes in ascending order, (m,) [rad/s or m/s]; zero occurs twice,
            once for each direction.
        torque: Friction torque at the nodes, with the sign of the velocity, (m,) [N m or N].
        sigma: Standard deviation of the friction torque, (m,).
        constant: Torque constant: ratio of reported to true torque.
        unit: Unit of the torque, "N m" or "N".
    """

    joint: str
    speed: Array
    torque: Array
    sigma: Array
    constant: float
    unit: str

    def __post_init__(self) -> None:
        k = len(self.speed)
        freeze_arrays(self, speed=(k,), torque=(k,), sigma=(k,))

    def torque_at_speed(self, speed: Array) -> Array:
        """Linearly interpolated friction torque, (M,) [N m or N]; constant beyond the end nodes.

        Args:
            speed: Joint velocities, (M,) [rad/s or m/s].
        """
        if not len(self.speed):
            return np.zeros_like(speed)
        return np.interp(speed, self.speed, self.torque)


def _node_law(direction: int, number: int) -> JointLaw:
    """Friction law whose coefficient is the torque at one node of the curve.

    The law is a hat function of velocity: 1 at its node, 0 at the other nodes and in the opposite
    direction of motion. For the last node it remains 1 at higher speeds.

    Args:
        direction: Direction of motion, 1 or -1.
        number: Index of the node.
    """
    nodal_values = np.eye(len(NODES))[number]

    def column(qd: Any, qdd: Any) -> Any:
        forward = direction * np.asarray(qd, dtype=float)
        return np.where(forward > 0, np.interp(forward, NODES, nodal_values), 0.0)

    return JointLaw(
        f"node {direction:+d} x {number}", "N m", "N", column, discontinuous=True
    )


NODE_LAWS = {
    (way, number): _node_law(way, number)
    for way in (-1, 1)
    for number in range(len(NODES))
}
"""Law of each node, by direction of motion and index of the node."""

Node = tuple[int, int]


def friction_curves(
    problem: Problem, bodies: Estimate, drives: Sequence[DriveEstimate] = ()
) -> tuple[FrictionCurve, ...]:
    """Estimate the friction curve and the torque constant of each joint.

    The rotor inertia and load-dependent friction in `drives` are not part of the curve; they are
    estimated at the same time. Nodes with fewer than `MIN_ROWS` rows are left out.

    Args:
        problem: Identification problem for the joint torques.
        bodies: Estimate from the plate's wrench, of this recording or another.
        drives: Estimates of the joints, whose terms are included; empty for no further terms.

    Raises:
        SettingsError: The estimate is not from the plate's wrench, or has other parameters.
    """
    tree = problem.tree
    other_laws = {
        tree.index(drive.joint): [
            term.law for term in drive.terms if term.law in (ROTOR, *LOAD_LAWS)
        ]
        for drive in drives
    }
    distinct_laws = dict.fromkeys(law for laws in other_laws.values() for law in laws)
    torques = torque_regression_data(
        problem, bodies, (*distinct_laws, *NODE_LAWS.values())
    )
    nodes = {joint: _used_nodes(torques, joint) for joint in torques.joints}
    coefficient_matrices = {}
    for joint, joint_nodes in nodes.items():
        matrices = [
            _interpolation_matrix(torques, joint, joint_nodes, direction)
            for direction in (-1, 1)
        ]
        coefficient_matrices[joint] = np.hstack(
            [*matrices, torques.terms(joint, other_laws.get(joint, ()))]
        )
    joint_regressions = fit_joint_regressions(torques, bodies, coefficient_matrices)
    return tuple(
        _friction_curve(tree, regression, nodes[regression.joint])
        for regression in joint_regressions
    )


def _used_nodes(torques: TorqueRegressionData, joint: int) -> list[Node]:
    """Nodes with at least `MIN_ROWS` effective rows, sorted by direction, then index.

    The negative direction comes first. The effective number of rows of a node is the sum of squares
    of its regressor column.
    """
    normal, _, _ = torques.equations.of_channel(joint)
    columns = torques.drives.columns @ torques.terms(joint, NODE_LAWS.values())
    effective_rows = np.einsum("ik,ij,jk->k", columns, normal, columns)
    return [
        node
        for node, rows in zip(NODE_LAWS, effective_rows, strict=True)
        if rows >= MIN_ROWS
    ]


def _interpolation_matrix(
    torques: TorqueRegressionData, joint: int, nodes: Sequence[Node], direction: int
) -> Array:
    """Matrix that interpolates torques at used nodes to the requested terms, (t, k).

    It maps the torques at the k used nodes of one direction to coefficients of the t requested
    terms. Torques at unused nodes are interpolated or extrapolated linearly in speed; they are
    constant if only one node is used.

    Args:
        torques: Regression data of the joint torques.
        joint: Joint index.
        nodes: Used nodes of both directions.
        direction: Direction of motion, 1 or -1.
    """
    speeds = np.array(NODES)
    used_speeds = speeds[
        [number for node_direction, number in nodes if node_direction == direction]
    ]
    weights = np.ones((len(speeds), len(used_speeds)))
    if len(used_speeds) > 1:
        weights = make_interp_spline(used_speeds, np.eye(len(used_speeds)), k=1)(speeds)
    laws = [
        law
        for (node_direction, _), law in NODE_LAWS.items()
        if node_direction == direction
    ]
    return torques.terms(joint, laws) @ weights


def _friction_curve(
    tree: Tree, regression: JointRegression, nodes: Sequence[Node]
) -> FrictionCurve:
    """Friction curve from the regression of a joint, with nodes in order of velocity."""
    torque, covariance = regression.true_coefficients
    sigma = standard_deviations(covariance)
    speed = np.array([direction * NODES[number] for direction, number in nodes])
    order = np.lexsort((np.array([direction for direction, _ in nodes]), speed))
    joint = tree.joints[regression.joint]
    return FrictionCurve(
        joint=joint.name,
        speed=speed[order],
        torque=torque[order],
        sigma=sigma[order],
        constant=float(regression.values[0]),
        unit="N m" if joint.revolute else "N",
    )


FOLDS = 8
"""Number of cross-validation folds of a recording."""


BLOCK_ROWS = 16
"""Number of consecutive rows that stay in one fold."""


@dataclass(frozen=True)
class JointTermChoice:
    """Friction laws selected for one joint.

    Attributes:
        laws: Selected laws, including the basic laws and the rotor, which every joint has.
        steps: Steps of the forward selection; the first contains only the laws that every joint
            has.
        next_best: Step with the best rejected law; None if no candidate was left.
    """

    laws: tuple[JointLaw, ...]
    steps: tuple[SelectionStep, ...]
    next_best: SelectionStep | None


def offered(laws: Sequence[JointLaw], signals: Collection[str]) -> tuple[JointLaw, ...]:
    """Candidate laws for the selection of a joint's terms.

    Args:
        laws: Laws of the settings; only the rotor inertia is taken from these.
        signals: Names of the recording's signals; temperature laws require "temperature".
    """
    rotor = tuple(law for law in laws if law == ROTOR)
    temperature_laws = tuple(law for law in DRIFT_LAWS if law.by in signals)
    return (*BASE_LAWS, *rotor, *CANDIDATE_LAWS, *LOAD_LAWS, *temperature_laws)


def chosen_terms(
    tree: Tree, torques: TorqueRegressionData, bodies: Estimate
) -> dict[int, JointTermChoice]:
    """Select the terms of each joint by cross-validation, keyed by joint index.

    Terms of load or temperature are dropped if their coefficient is below `Z_THRESHOLD` standard
    deviations.

    Args:
        tree: The robot.
        torques: Regression data with the columns of all candidate laws.
        bodies: Estimate from the plate's wrench.
    """
    products = _fold_products(torques)
    choices = {
        joint: _chosen_laws(torques, joint, products) for joint in torques.joints
    }
    for regression in fit_joint_regressions(
        torques, bodies, term_selection_matrices(torques, choices)
    ):
        choice = choices[regression.joint]
        terms = drive_estimate(tree, torques, regression).terms
        significant = {
            term.law for term in terms if abs(term.value) >= Z_THRESHOLD * term.sigma
        }
        insignificant = {*LOAD_LAWS, *DRIFT_LAWS} - significant
        laws = tuple(law for law in choice.laws if law not in insignificant)
        kinds = {"", *(law.kind for law in laws)}
        steps = tuple(step for step in choice.steps if step.kind in kinds)
        choices[regression.joint] = replace(choice, laws=laws, steps=steps)
    return choices


def term_selection_matrices(
    torques: TorqueRegressionData, choices: Mapping[int, JointTermChoice]
) -> dict[int, Array]:
    """Selection matrices of the chosen terms, keyed by joint index, (t, q).

    Each selects the joint's q chosen terms from the t requested terms.

    Args:
        torques: Regression data with the columns of all candidate laws.
        choices: Selected laws, keyed by joint index.
    """
    return {
        joint: torques.terms(joint, choice.laws) for joint, choice in choices.items()
    }


def _fold_products(torques: TorqueRegressionData) -> CrossProducts:
    """Products of all joints' columns and torques in `FOLDS` cross-validation folds.

    A fold consists of consecutive rows.
    """
    rows = torques.passes.rows(torques.combined)
    blocks_by_fold = np.array_split(
        range(0, torques.passes.plan.rows, BLOCK_ROWS), FOLDS
    )
    with one_blas_thread():
        blocks = (np.concatenate([x, y[..., None]], axis=2) for x, y in rows)
        return Folds(
            np.cumsum(
                [0, *(BLOCK_ROWS * len(fold_blocks) for fold_blocks in blocks_by_fold)]
            )
        ).products(blocks)


def _chosen_laws(
    torques: TorqueRegressionData, joint: int, products: CrossProducts
) -> JointTermChoice:
    """Select the laws of a joint by forward selection with cross-validation.

    Stribeck friction is a candidate only if there are enough slow rows: its coefficient is the
    friction at zero speed, which faster rows determine only by extrapolation.

    Args:
        torques: Regression data with the columns of all candidate laws.
        joint: Joint index.
        products: Products of columns and torques by fold.
    """
    asked = torques.drives.asked
    columns = {term.law: 1 + k for k, term in enumerate(asked) if term.joint == joint}
    laws = [law for law in columns if law in (*BASE_LAWS, ROTOR)]
    folds = products.weighted_sums(np.eye(products.test.shape[1])[joint])
    squares = np.einsum("kii->i", folds.test)
    candidates = {
        law: column
        for law, column in columns.items()
        if law not in laws
        and (STRIBECK_KIND not in law.kind or squares[column] >= MIN_ROWS)
    }
    selected_laws, selection = forward_selection(
        folds,
        [0, *(columns[law] for law in laws)],
        candidates,
        lambda law: law.kind,
        are_exclusive,
    )
    return JointTermChoice(
        (*laws, *selected_laws), selection.steps, selection.next_best
    )


Z_THRESHOLD = 4.0
"""Smallest coefficient of load or temperature that is kept, in standard deviations: errors of dry
friction near velocity reversals resemble these terms."""


@dataclass(frozen=True)
class DriveTerm:
    """Coefficient of a joint term, in terms of true torque.

    Attributes:
        law: Law of the term.
        unit: Unit of the coefficient.
        value: The coefficient.
        sigma: Standard deviation of the coefficient.
    """

    law: JointLaw
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class DriveEstimate:
    """Torque constant and joint terms of one joint.

    Attributes:
        joint: Name of the joint.
        constant: Torque constant: ratio of reported to true torque, 1 for a perfect drive.
        sigma: Standard deviation of the torque constant.
        terms: Joint terms, in terms of true torque.
        residual: Rms residual in reported torque [N m or N].
        unit: N m or N.
        rows: Number of rows used in the fit.
        choice: Selection of the terms; None if the terms were given by the settings.
    """

    joint: str
    constant: float
    sigma: float
    terms: tuple[DriveTerm, ...]
    residual: float
    unit: str
    rows: int
    choice: JointTermChoice | None = None

    def friction(self, speed: Array, load: Array) -> Array:
        """Friction torque, including offset, at constant velocities and 25 degC, (M,) [N m or N].

        Terms of drift and temperature are not included.

        Args:
            speed: Joint velocities, (M,) [rad/s or m/s].
            load: Torque that moves the link, (M,) [N m or N].
        """
        torque = np.zeros(np.broadcast_shapes(np.shape(speed), np.shape(load)))
        for term in self.terms:
            law = term.law
            scale = (
                LOAD_MULTIPLIERS[law.by](load, load)
                if law.by in LOAD_MULTIPLIERS
                else float(not law.by)
            )
            torque = torque + term.value * scale * law.columns(
                speed, np.zeros_like(speed)
            )
        return torque


def drive_estimate(
    tree: Tree,
    torques: TorqueRegressionData,
    regression: JointRegression,
    choice: JointTermChoice | None = None,
) -> DriveEstimate:
    """Torque constant and terms of a joint, from its regression.

    The coefficients of the terms are converted from reported to true torque.

    Args:
        tree: The robot.
        torques: Regression data with all terms.
        regression: Regression of the joint, with one coefficient per term.
        choice: Selection of the terms, if they were selected.
    """
    laws = [torques.drives.asked[k].law for k in regression.terms.argmax(axis=0)]
    joint = tree.joints[regression.joint]
    terms, covariance = regression.true_coefficients
    sigmas = standard_deviations(covariance)
    return DriveEstimate(
        joint=joint.name,
        constant=float(regression.values[0]),
        sigma=float(standard_deviations(regression.covariance)[0]),
        terms=tuple(
            DriveTerm(law, law.unit(joint), float(value), float(sigma))
            for law, value, sigma in zip(laws, terms, sigmas, strict=True)
        ),
        residual=regression.residual,
        unit="N m" if joint.revolute else "N",
        rows=regression.rows,
        choice=choice,
    )
