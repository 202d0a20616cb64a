"""Friction torque as a curve over velocity, with a band: no law is assumed.

The curve is straight between nodes, one curve for each direction of motion; the torque at a node is
the coefficient of a law of its own, so that filters, weights and sigma are those of every law.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from testbed.applications.drives.joint_regression import (
    JointRegression,
    Torques,
    regressions,
    torques_beside,
)
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import standard_deviations
from testbed.core.estimation.selection.folds import CrossProducts, Folds
from testbed.core.estimation.selection.held_out import (
    ALWAYS,
    OFFERED,
    SelectionStep,
    forward_selection,
    rivals,
)
from testbed.core.robot.friction import BY_LOAD, LOADED, ROTOR, STRIBECK, VARYING
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
"""Speeds of the nodes [rad/s or m/s]: close where friction changes most."""

LEAST = 4.0
"""Rows' worth of data that a node needs, and friction that fades out."""


@dataclass(frozen=True, eq=False)
class FrictionCurve:
    """One joint's friction over velocity.

    Attributes:
        joint: Its name.
        speed: Of the nodes, ascending; zero is there twice, for either direction, (m,)
            [rad/s or m/s].
        torque: What friction takes there, with the sign of the motion, (m,) [N m or N].
        sigma: Standard deviations, (m,).
        constant: What the drive reports over what the torque is.
        unit: N m or N.
    """

    joint: str
    speed: Array
    torque: Array
    sigma: Array
    constant: float
    unit: str

    def __post_init__(self) -> None:
        k = len(self.speed)
        freeze(self, speed=(k,), torque=(k,), sigma=(k,))

    def at(self, speed: Array) -> Array:
        """Friction at speeds, straight between nodes and as at the last ones beyond, (M,).

        Args:
            speed: (M,) [rad/s or m/s].
        """
        if not len(self.speed):
            return np.zeros_like(speed)
        return np.interp(speed, self.speed, self.torque)


def _node_law(way: int, number: int) -> JointLaw:
    """The law whose coefficient is the torque at a node, for motion of one direction, 1 or -1."""
    heights = np.eye(len(NODES))[number]

    def column(qd: Any, qdd: Any) -> Any:
        forward = way * np.asarray(qd, dtype=float)
        return np.where(forward > 0, np.interp(forward, NODES, heights), 0.0)

    return JointLaw(f"node {way:+d} x {number}", "N m", "N", column, jumps=True)


NODE_LAWS = {
    (way, number): _node_law(way, number)
    for way in (-1, 1)
    for number in range(len(NODES))
}
"""By direction and number of the node."""

Node = tuple[int, int]


def friction_curves(
    problem: Problem, bodies: Estimate, drives: Sequence[DriveEstimate] = ()
) -> tuple[FrictionCurve, ...]:
    """Friction over velocity, joint by joint, with the torque constant found beside it.

    What a joint has besides friction over velocity is found beside it, too: a rotor, friction that
    the load adds.

    Args:
        problem: By joint torques.
        bodies: The external estimate: of this recording or of another.
        drives: One a joint, or none: which terms it has.

    Raises:
        SettingsError: The estimate is not the plate's, or not of these parameters.
    """
    tree = problem.tree
    others = {
        tree.index(each.joint): [t.law for t in each.terms if t.law in (ROTOR, *LOADED)]
        for each in drives
    }
    beside = dict.fromkeys(law for own in others.values() for law in own)
    torques = torques_beside(problem, bodies, (*beside, *NODE_LAWS.values()))
    nodes = {joint: _nodes(torques, joint) for joint in torques.joints}
    picked = {}
    for joint, own in nodes.items():
        parts = [_between_nodes(torques, joint, own, way) for way in (-1, 1)]
        picked[joint] = np.hstack([*parts, torques.terms(joint, others.get(joint, ()))])
    found = regressions(torques, bodies, picked)
    return tuple(_curve(tree, each, nodes[each.joint]) for each in found)


def _nodes(torques: Torques, joint: int) -> list[Node]:
    """The nodes with enough data, backwards first, ascending numbers."""
    normal, _, _ = torques.equations.of_channel(joint)
    columns = torques.drives.columns @ torques.terms(joint, NODE_LAWS.values())
    worth = np.einsum("ik,ij,jk->k", columns, normal, columns)
    return [node for node, rows in zip(NODE_LAWS, worth, strict=True) if rows >= LEAST]


def _between_nodes(
    torques: Torques, joint: int, nodes: Sequence[Node], way: int
) -> Array:
    """How torques at the nodes with enough data make those at all of one direction, (asked, k)."""
    places = np.array(NODES)
    kept = places[[number for each, number in nodes if each == way]]
    weights = np.ones((len(places), len(kept)))
    if len(kept) > 1:
        weights = make_interp_spline(kept, np.eye(len(kept)), k=1)(places)
    laws = [law for (each, _), law in NODE_LAWS.items() if each == way]
    return torques.terms(joint, laws) @ weights


def _curve(tree: Tree, found: JointRegression, nodes: Sequence[Node]) -> FrictionCurve:
    torque, covariance = found.as_they_are
    sigma = standard_deviations(covariance)
    speed = np.array([way * NODES[number] for way, number in nodes])
    order = np.lexsort((np.array([way for way, _ in nodes]), speed))
    joint = tree.joints[found.joint]
    return FrictionCurve(
        joint=joint.name,
        speed=speed[order],
        torque=torque[order],
        sigma=sigma[order],
        constant=float(found.values[0]),
        unit="N m" if joint.revolute else "N",
    )


PARTS = 8
"""Of a recording."""


RUN = 16
"""Rows that are of one part together."""


@dataclass(frozen=True)
class Choice:
    """The terms of one joint.

    Attributes:
        laws: All of them.
        steps: How they were found, the first being what every joint has.
        next_best: The law that would have come next, and does not gain enough; None for none.
    """

    laws: tuple[JointLaw, ...]
    steps: tuple[SelectionStep, ...]
    next_best: SelectionStep | None


def offered(laws: Sequence[JointLaw], signals: Collection[str]) -> tuple[JointLaw, ...]:
    """All laws that a choice needs columns of; a rotor where it is asked for.

    Args:
        laws: What is asked for.
        signals: Of the recording: laws of the temperature need it.
    """
    rotor = tuple(law for law in laws if law == ROTOR)
    warm = tuple(law for law in VARYING if law.by in signals)
    return (*ALWAYS, *rotor, *OFFERED, *LOADED, *warm)


def chosen_terms(tree: Tree, torques: Torques, bodies: Estimate) -> dict[int, Choice]:
    """The terms of every joint by held-out data; of load or temperature none that might be zero.

    Args:
        tree: The robot.
        torques: With columns of all laws that are `offered`.
        bodies: The external estimate.
    """
    products = _products(torques)
    choices = {joint: _choice(torques, joint, products) for joint in torques.joints}
    for found in regressions(torques, bodies, picked_terms(torques, choices)):
        choice = choices[found.joint]
        terms = drive_of(tree, torques, found).terms
        clear = {t.law for t in terms if abs(t.value) >= CLEAR * t.sigma}
        doubtful = {*LOADED, *VARYING} - clear
        laws = tuple(law for law in choice.laws if law not in doubtful)
        kinds = {"", *(law.kind for law in laws)}
        steps = tuple(step for step in choice.steps if step.kind in kinds)
        choices[found.joint] = replace(choice, laws=laws, steps=steps)
    return choices


def picked_terms(torques: Torques, choices: Mapping[int, Choice]) -> dict[int, Array]:
    """By joint, which of the asked terms its regression has, (asked, q).

    Args:
        torques: With columns of all laws.
        choices: By joint.
    """
    return {joint: torques.terms(joint, each.laws) for joint, each in choices.items()}


def _products(torques: Torques) -> CrossProducts:
    """Products of every joint's columns and torque, fold by fold."""
    rows = torques.passes.rows(torques.combined)
    parts = np.array_split(range(0, torques.passes.plan.rows, RUN), PARTS)
    with one_blas_thread():
        blocks = (np.concatenate([x, y[..., None]], axis=2) for x, y in rows)
        return Folds(np.cumsum([0, *(RUN * len(part) for part in parts)])).products(
            blocks
        )


def _choice(torques: Torques, joint: int, products: CrossProducts) -> Choice:
    """Laws are added as long as one gains enough on parts that the fit has not seen.

    Friction that fades out is offered where rows are slow enough: its coefficient is friction at
    rest, which faster ones extrapolate to without bound.
    """
    asked = torques.drives.asked
    place = {term.law: 1 + k for k, term in enumerate(asked) if term.joint == joint}
    laws = [law for law in place if law in (*ALWAYS, ROTOR)]
    folds = products.weighted(np.eye(products.unseen.shape[1])[joint])
    squares = np.einsum("kii->i", folds.unseen)
    candidates = {
        law: at
        for law, at in place.items()
        if law not in laws and (STRIBECK not in law.kind or squares[at] >= LEAST)
    }
    more, how = forward_selection(
        folds,
        [0, *(place[law] for law in laws)],
        candidates,
        lambda law: law.kind,
        rivals,
    )
    return Choice((*laws, *more), how.steps, how.next_best)


CLEAR = 4.0
"""Standard deviations that a chosen coefficient of load or temperature has to have: errors of dry
friction near reversals have some of its shape."""


@dataclass(frozen=True)
class DriveTerm:
    """One coefficient of a joint's own torque, as it is, not as the drive reports it.

    Attributes:
        law: Which.
        unit: Of the coefficient.
        value: The coefficient.
        sigma: Its standard deviation.
    """

    law: JointLaw
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class DriveEstimate:
    """What the plate's parameters make of one joint's torque.

    Attributes:
        joint: Its name.
        constant: What the drive reports over what the torque is: 1 if the torque constant is right.
        sigma: Its standard deviation.
        terms: The joint's own.
        residual: Rms of what is left, as reported [N m or N].
        unit: N m or N.
        rows: How many counted.
        choice: How the terms were chosen; None where they were given.
    """

    joint: str
    constant: float
    sigma: float
    terms: tuple[DriveTerm, ...]
    residual: float
    unit: str
    rows: int
    choice: Choice | None = None

    def friction(self, speed: Array, load: Array) -> Array:
        """What its terms take at constant speeds and 25 degC, with the offset, (M,) [N m or N].

        Args:
            speed: (M,) [rad/s or m/s].
            load: Torque that moves the link, (M,) [N m or N].
        """
        found = np.zeros(np.broadcast_shapes(np.shape(speed), np.shape(load)))
        for term in self.terms:
            law = term.law
            by = BY_LOAD[law.by](load, load) if law.by in BY_LOAD else float(not law.by)
            found = found + term.value * by * law.columns(speed, np.zeros_like(speed))
        return found


def drive_of(
    tree: Tree, torques: Torques, found: JointRegression, choice: Choice | None = None
) -> DriveEstimate:
    """A joint's regression in words: its own terms as they are, not as reported.

    Args:
        tree: The robot.
        torques: With all terms.
        found: The regression, each coefficient that of one term.
        choice: How its terms were chosen.
    """
    laws = [torques.drives.asked[k].law for k in found.terms.argmax(axis=0)]
    joint = tree.joints[found.joint]
    terms, covariance = found.as_they_are
    sigmas = standard_deviations(covariance)
    return DriveEstimate(
        joint=joint.name,
        constant=float(found.values[0]),
        sigma=float(standard_deviations(found.covariance)[0]),
        terms=tuple(
            DriveTerm(law, law.unit(joint), float(value), float(sigma))
            for law, value, sigma in zip(laws, terms, sigmas, strict=True)
        ),
        residual=found.residual,
        unit="N m" if joint.revolute else "N",
        rows=found.rows,
        choice=choice,
    )
