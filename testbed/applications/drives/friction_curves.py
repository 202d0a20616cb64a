"""Friction torque as a curve over velocity, with a band: no law is assumed.

The curve is straight between nodes, one curve for each direction of motion; the torque at a node is
the coefficient of a law of its own, so that filters, weights and sigma are those of every law.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from testbed.applications.drives.joint_regression import (
    JointRegression,
    Torques,
    all_terms,
    dependent,
    regressions,
    torques_beside,
)
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    standard_deviations,
)
from testbed.core.estimation.selection.held_out import ALWAYS, OFFERED, Parts, Step, grown, rivals
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.robot.friction import (
    BY_LOAD,
    LOAD,
    LOADED,
    ROOM,
    ROTOR,
    STRIBECK,
    VARYING,
    JointLaw,
    JointTerm,
)
from testbed.core.robot.tree import Tree

NODES = (
    0.0,
    0.03,
    0.06,
    0.1,
    0.15,
    0.2,
    0.3,
    0.45,
    0.7,
    1.0,
    1.4,
    2.0,
    2.8,
    4.0,
    5.6,
    8.0,
    11.0,
    16.0,
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
        hysteresis: What friction takes more at a speed that is increasing than at the same speed
            when decreasing, and its standard deviation; None where no motion shows it.
    """

    joint: str
    speed: Array
    torque: Array
    sigma: Array
    constant: float
    unit: str
    hysteresis: tuple[float, float] | None = None

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


HYSTERESIS = JointLaw("hysteresis", "N m", "N", lambda qd, qdd: np.sign(qdd))
"""Half the difference between friction of increasing and of decreasing speed: against the motion
it is sign(dv/dt) sign(v)."""


@lru_cache
def node_law(number: int, direction: int) -> JointLaw:
    """The law whose coefficient is the torque at a node.

    Args:
        number: Of the node.
        direction: Of the motion, 1 or -1.
    """
    kind = f"node {'-' if direction < 0 else ''}{number}"
    return JointLaw(kind, "N m", "N", _hat(number, direction), jumps=True)


def _hat(number: int, direction: int) -> Callable[[Any, Any], Any]:
    places = np.array(NODES)
    heights = np.eye(len(NODES))[number]

    def column(qd: Any, qdd: Any) -> Any:
        del qdd
        forward = direction * np.asarray(qd, dtype=float)
        return np.where(forward > 0, np.interp(forward, places, heights), 0.0)

    return column


LAWS = tuple(node_law(number, way) for way in (1, -1) for number in range(len(NODES)))
"""Of all nodes, forwards and then backwards."""


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
    others: list[list[JointLaw]] = [[] for _ in range(tree.n)]
    for each in drives:
        own = (term.law for term in each.terms if term.law in (ROTOR, *LOADED))
        others[tree.index(each.joint)] += own
    beside = dict.fromkeys((HYSTERESIS, ROTOR, *(law for own in others for law in own)))
    torques = torques_beside(problem, bodies, (*beside, *LAWS))
    nodes = [_nodes_of(j, torques.drives, torques.equations) for j in range(tree.n)]

    def pick(joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
        del equations
        return _straight_between(nodes[joint], others[joint], joint, drives)

    def pick_both_ways(joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
        """With hysteresis, and a rotor's torque, which would look like it, as far as they show."""
        least = [law for law in others[joint] if law != ROTOR]
        for more in ([HYSTERESIS, ROTOR], [HYSTERESIS]):
            picked = _straight_between(nodes[joint], [*more, *least], joint, drives)
            if not dependent(equations, joint, torques.combined @ block_diag(1.0, picked)):
                return picked
        return pick(joint, drives, equations)

    found = regressions(torques, bodies, pick)
    both = regressions(torques, bodies, pick_both_ways)
    loops = (_hysteresis(each, torques.drives.asked) for each in both)
    curves = (_curve(tree, each, nodes[each.joint]) for each in found)
    return tuple(replace(c, hysteresis=h) for c, h in zip(curves, loops, strict=True))


def _hysteresis(found: JointRegression, asked: Sequence[JointTerm]) -> tuple[float, float] | None:
    """Difference and standard deviation; None where rows do not show it."""
    place = asked.index(JointTerm(HYSTERESIS, found.joint))
    values, covariance = found.as_they_are
    half = found.terms[place]
    if not half.any():
        return None
    return float(2 * half @ values), float(2 * np.sqrt(half @ covariance @ half))


def _straight_between(
    nodes: list[tuple[int, int]], others: list[JointLaw], joint: int, drives: DriveSet
) -> Array:
    """Torques at the nodes of which there are enough data make those at all; others stay."""
    columns: list[Array] = []
    place = {term.law: k for k, term in enumerate(drives.asked) if term.joint == joint}
    for way in (-1, 1):
        kept = [number for number, each in nodes if each == way]
        places = np.array(NODES)
        for column in _straight(places, places[kept]).T:
            full = np.zeros(len(drives.asked))
            full[[place[node_law(k, way)] for k in range(len(NODES))]] = column
            columns.append(full)
    columns += [np.eye(len(drives.asked))[place[law]] for law in others]
    return np.array(columns).reshape(-1, len(drives.asked)).T


def _nodes_of(joint: int, drives: DriveSet, equations: NormalEquations) -> list[tuple[int, int]]:
    """Number and direction of the nodes with enough data, backwards first, ascending numbers."""
    normal, _, _ = equations.of_channel(joint)
    worth = {}
    for k, term in enumerate(drives.asked):
        if term.joint == joint and term.law in LAWS:
            column = drives.columns[:, k]
            worth[term.law] = float(column @ normal @ column)
    return [
        (number, way)
        for way in (-1, 1)
        for number in range(len(NODES))
        if worth[node_law(number, way)] >= LEAST
    ]


def _straight(places: Array, nodes: Array) -> Array:
    """Weights of values at nodes in straight lines through them, and beyond, (len(places), k)."""
    if len(nodes) < 2:
        return np.ones((len(places), len(nodes)))
    at = np.clip(np.searchsorted(nodes, places) - 1, 0, len(nodes) - 2)
    share = (places - nodes[at]) / (nodes[at + 1] - nodes[at])
    found, rows = np.zeros((len(places), len(nodes))), np.arange(len(places))
    found[rows, at], found[rows, at + 1] = 1 - share, share
    return found


def _curve(tree: Tree, found: JointRegression, nodes: list[tuple[int, int]]) -> FrictionCurve:
    torque, covariance = found.as_they_are
    sigma = standard_deviations(covariance)
    speed = np.array([way * NODES[number] for number, way in nodes])
    order = np.lexsort((np.array([way for _, way in nodes]), speed))
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
"""Rows whose products are kept as one."""


@dataclass(frozen=True)
class Choice:
    """The terms of one joint.

    Attributes:
        laws: All of them.
        steps: How they were found, the first being what every joint has.
        next_best: The law that would have come next, and does not gain enough; None for none.
    """

    laws: tuple[JointLaw, ...]
    steps: tuple[Step, ...]
    next_best: Step | None


def offered(laws: Sequence[JointLaw], signals: Collection[str]) -> tuple[JointLaw, ...]:
    """All laws that a choice needs columns of; a rotor where it is asked for.

    Args:
        laws: What is asked for.
        signals: Of the recording: laws of the temperature need it.
    """
    rotor = tuple(law for law in laws if law == ROTOR)
    warm = tuple(law for law in VARYING if law.by in signals)
    return (*ALWAYS, *rotor, *OFFERED, *LOADED, *warm)


def choices(torques: Torques) -> tuple[Choice, ...]:
    """The terms of every joint, chosen by held-out data.

    Args:
        torques: With columns of all laws that are `offered`.
    """
    asked = torques.drives.asked
    found = []
    for joint, products in enumerate(_products(torques)):
        place = {term.law: 1 + k for k, term in enumerate(asked) if term.joint == joint}
        found.append(_choice(products, place))
    return tuple(found)


def _products(torques: Torques) -> list[Array]:
    """By joint, the products of its columns and torque, of every part, (PARTS, m, m)."""
    n = len(torques.equations.channels)
    runs: list[list[Array]] = [[] for _ in range(n)]
    with one_blas_thread():
        for columns, measured in torques.passes.rows(torques.combined):
            for joint in range(n):
                all_rows = np.column_stack([columns[joint], measured[joint]])
                for first in range(0, len(all_rows), RUN):
                    part = all_rows[first : first + RUN]
                    runs[joint].append(part.T @ part)
    return [
        np.array([np.sum(part, axis=0) for part in np.array_split(np.array(each), PARTS)])
        for each in runs
    ]


def _choice(products: Array, place: dict[JointLaw, int]) -> Choice:
    """Of one joint's products: laws are added as long as one gains enough.

    Friction that fades out is offered where rows are slow enough: its coefficient is friction at
    rest, which faster ones extrapolate to without bound.
    """
    laws = [law for law in place if law in (*ALWAYS, ROTOR)]
    whole = products.sum(axis=0)
    parts = Parts(products, whole - products)
    seen = {
        law: at for law, at in place.items() if STRIBECK not in law.kind or whole[at, at] >= LEAST
    }
    more, how = grown(
        parts,
        [0, *(place[law] for law in laws)],
        {law: at for law, at in seen.items() if law not in laws},
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

    def shares(self, constant: float) -> tuple[float, float]:
        """What of the load the gear loses where it drives and where it is driven.

        The torques show two slopes, not these two and the torque constant: one has to be known.

        Args:
            constant: What the drive reports over what the torque is, from elsewhere.
        """
        loss = next((term.value for term in self.terms if term.law == LOAD), 0.0)
        slopes = self.constant * (1 + loss) / constant, self.constant * (1 - loss) / constant
        return slopes[0] - 1, 1 - slopes[1]

    def friction(self, speed: Array, load: Array, temperature: Array | float = ROOM) -> Array:
        """What its terms take at constant speeds, with the offset, (M,) [N m or N].

        Args:
            speed: (M,) [rad/s or m/s].
            load: Torque that moves the link, (M,) [N m or N].
            temperature: Of the drive, (M,) [degC].
        """
        found = np.zeros(np.broadcast_shapes(np.shape(speed), np.shape(load)))
        for law, value in ((term.law, term.value) for term in self.terms):
            by = BY_LOAD[law.by](load, load) if law.by in BY_LOAD else float(not law.by)
            if law.by == "temperature":
                by = temperature - ROOM
            found = found + value * by * law.columns(speed, np.zeros_like(speed))
        return found


@dataclass(frozen=True)
class ChosenTerms:
    """Which terms each joint has.

    Attributes:
        choices: By joint, chosen by held-out data; None where each joint has all.
    """

    choices: tuple[Choice, ...] | None

    def pick(self, joint: int, drives: DriveSet, equations: NormalEquations) -> Array:
        """As `drive_regression.Pick`."""
        every = all_terms(joint, drives, equations)
        if self.choices is None:
            return every
        laws = self.choices[joint].laws
        own = [k for k, t in enumerate(drives.asked) if t.joint == joint and t.law in laws]
        return np.eye(len(drives.asked))[:, own]

    def estimates(
        self, tree: Tree, torques: Torques, found: Sequence[JointRegression]
    ) -> tuple[DriveEstimate, ...]:
        """Every joint's regression in words."""
        chosen: Sequence[Choice | None] = self.choices or [None] * tree.n
        return tuple(
            replace(drive_of(tree, torques.drives.asked, each), choice=chosen[each.joint])
            for each in found
        )


def chosen_terms(tree: Tree, torques: Torques, bodies: Estimate) -> ChosenTerms:
    """The terms of every joint by held-out data; of load or temperature none that might be zero.

    Args:
        tree: The robot.
        torques: With columns of all laws that are `offered`.
        bodies: The external estimate.
    """
    open_ones = choices(torques)
    before = ChosenTerms(open_ones)
    found = regressions(torques, bodies, before.pick)
    clear, doubtful = list(open_ones), (*LOADED, *VARYING)
    for own, drive in zip(found, before.estimates(tree, torques, found), strict=True):
        choice = open_ones[own.joint]
        kept = {t.law for t in drive.terms if abs(t.value) >= CLEAR * t.sigma}
        laws = tuple(law for law in choice.laws if law not in doubtful or law in kept)
        kinds = {"", *(law.kind for law in laws)}
        steps = tuple(step for step in choice.steps if step.kind in kinds)
        clear[own.joint] = replace(choice, laws=laws, steps=steps)
    return ChosenTerms(tuple(clear))


def drive_of(tree: Tree, asked: Sequence[JointTerm], found: JointRegression) -> DriveEstimate:
    """A joint's regression in words: its own terms as they are, not as reported.

    Args:
        tree: The robot.
        asked: All terms.
        found: The regression, each coefficient that of one term.
    """
    laws = [asked[k].law for k in found.terms.argmax(axis=0)]
    joint = tree.joints[found.joint]
    terms, covariance = found.as_they_are
    sigmas = standard_deviations(covariance)
    return DriveEstimate(
        joint=joint.name,
        constant=float(found.values[0]),
        sigma=float(np.sqrt(max(float(found.covariance[0, 0]), 0.0))),
        terms=tuple(
            DriveTerm(law, law.unit(joint), float(value), float(sigma))
            for law, value, sigma in zip(laws, terms, sigmas, strict=True)
        ),
        residual=found.residual,
        unit="N m" if joint.revolute else "N",
        rows=found.rows,
    )
