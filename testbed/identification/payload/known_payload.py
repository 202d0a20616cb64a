"""A payload that is known beforehand, and what two recordings tell of the plate with it.

One recording of a robot that carries it tells nothing more: the payload is a part of its link then.
Two recordings, without it and with it, are of robots that differ by what is known; like any fact
with a size this tells the scale of the plate, and it is seen before any data whether it suffices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from testbed.arrays import Array, readonly
from testbed.errors import SettingsError, UnknownName
from testbed.identification.payload.payload import seen_of_payload
from testbed.identification.problem import Problem
from testbed.identification.regression.constraints import PAYLOAD, facts, free
from testbed.identification.sensor.catalogue import NUISANCES
from testbed.identification.sensor.identifiability import (
    NonIdentifiable,
    enough,
    generic_columns,
    generic_robot,
    identifiable_subset,
    in_turn,
)
from testbed.identification.sensor.nuisance import Nuisance
from testbed.identification.sensor.offsets import BIAS, TARE
from testbed.identification.sensor.unknowns import unknowns_of
from testbed.parameters.barycentric import to_barycentric
from testbed.robot.tree import Tree

MASS = f"{PAYLOAD}mass"

CENTRE = tuple(f"{PAYLOAD}{axis}" for axis in "xyz")

DOUBT = 0.3
"""Sigma of what one recording leaves open of the plate, or is known of it with a doubt that counts
elsewhere: nothing beside what the payload says."""

SEEDS = (1996, 562)
"""Of the two generic motions."""


@dataclass(frozen=True, eq=False)
class KnownPayload:
    """Ten parameters m, mx, ..., Izz about and along the frame of the link that carries it.

    Attributes:
        joint: The link is the one that this joint moves.
        values: (10,); zero where nothing is known.
        root: R with R R' their covariance, (10, 4).
        unknown: Places of those that nothing is known of.
    """

    joint: str
    values: Array
    root: Array
    unknown: tuple[int, ...]

    def __post_init__(self) -> None:
        for name, shape in (("values", (10,)), ("root", (10, 4))):
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))


def known_payload(
    tree: Tree, joint: str | None, given: Mapping[str, tuple[float, float]]
) -> KnownPayload:
    """A payload of what is known of it: its mass, and coordinates of its centre.

    Args:
        tree: The robot.
        joint: Of the link that carries it; default the last.
        given: Value and sigma by name: "payload/mass" [kg], "payload/x", y, z [m], along and from
            the link's frame.

    Raises:
        UnknownName: There is no such fact, or joint.
        SettingsError: The mass is not among them, or not positive.
    """
    for name in given:
        if name not in (MASS, *CENTRE):
            raise UnknownName("known fact", name, (MASS, *CENTRE))
    if MASS not in given or given[MASS][0] <= 0:
        raise SettingsError(
            f"of the payload its mass has to be known, in kg: --known {MASS}=1.5; "
            "coordinates of its centre help where they are known"
        )
    mass, sigma = given[MASS]
    values, root = np.zeros(10), np.zeros((10, 4))
    values[0], root[0, 0] = mass, sigma
    for k, name in enumerate(CENTRE, start=1):
        place, spread = given.get(name, (0.0, 0.0))
        values[k], root[k, 0], root[k, k] = mass * place, sigma * place, mass * spread
    unknown = [k for k, name in enumerate(CENTRE, start=1) if name not in given]
    carrier = tree.names[tree.index(joint or tree.names[-1])]
    return KnownPayload(carrier, values, root, (*unknown, *range(4, 10)))


def nuisances_of(problem: Problem) -> list[Nuisance]:
    """The kinds of the instrument's unknowns that are asked for.

    Args:
        problem: By the plate.
    """
    return [n for n in NUISANCES if n.kind in problem.settings.nuisances]


def open_alone(problem: Problem) -> tuple[str, ...]:
    """Numbers of the plate that hold for other recordings, too, and that one does not tell alone.

    Args:
        problem: Robot and recording.
    """
    tree, asked = problem.tree, nuisances_of(problem)
    every = unknowns_of(tree, asked)
    stated = facts(tree, problem.minimal, problem.names, every.names, problem.settings.facts)
    _, nonidentifiable = identifiable_subset(problem, asked, stated)
    lasting = {p.name for n in asked if n.whole for p in n.parts(tree)}
    return tuple(each.name for each in nonidentifiable if each.name in lasting)


def _constants(problem: Problem) -> Array:
    """Directions of the parameters that show as a constant, where that is unknown, (N, k)."""
    count = problem.minimal.count
    if not {BIAS, TARE} & set(nuisances_of(problem)):
        return np.zeros((count, 0))
    rng, rows = np.random.default_rng(SEEDS[0]), enough(count)
    theta = generic_robot(problem.layout, rng)
    own, _ = generic_columns(problem, (BIAS,), rows, theta, rng)
    changing = own.reshape(rows, 6, -1) - own.reshape(rows, 6, -1).mean(axis=0)
    scale = np.linalg.norm(own, axis=0)
    return np.asarray(null_space(changing.reshape(6 * rows, -1) / scale) / scale[:, None])


@dataclass(frozen=True, eq=False)
class Pair:
    """Two recordings, without the payload and with it.

    Attributes:
        without: The first; its robot may have known zeros, and known facts.
        loaded: The second: of it nothing is known but the plate.
        payload: What is known of the payload.
        lift: How the first's minimal parameters make the second's, without payload, (N', N).
        adds: What each of the payload's ten parameters adds to them, (N', 10).
    """

    without: Problem
    loaded: Problem
    payload: KnownPayload
    lift: Array
    adds: Array

    @property
    def free(self) -> Array:
        """Directions in which the second's may differ beyond what is known, (N', k)."""
        return np.column_stack([self.adds[:, list(self.payload.unknown)], _constants(self.loaded)])

    @property
    def open(self) -> tuple[NonIdentifiable, ...]:
        """Numbers of the plate that both recordings together do not tell: a generic robot's."""
        half, tree = self.without, self.without.tree
        own, count, asked = half.minimal.names, half.minimal.count, nuisances_of(half)
        passing, lasting = (
            unknowns_of(tree, [n for n in asked if n.passing is each]) for each in (True, False)
        )
        numbers = (*passing.names, *lasting.names)
        left = free(facts(tree, half.minimal, own, numbers, half.settings.facts))
        about = left.lead[:count].any(axis=0)
        sure = [not row.any() for row in left.lead[count:]]
        (robot, theirs), (again, others), more = self._columns(enough(count + len(numbers)))
        b, rows = len(passing.names), len(robot)
        columns = np.zeros((2 * rows, more.shape[1] + 2 * b + len(lasting.names)))
        at_first, at_second, last = np.cumsum([more.shape[1], b, b])
        columns[rows:, :at_first] = more
        columns[:rows, at_first:at_second] = theirs[:, :b]
        columns[rows:, at_second:last] = others[:, :b]
        columns[:, last:] = np.vstack([theirs[:, b:], others[:, b:]])
        names = ["the payload"] * more.shape[1] + [*passing.names] * 2 + [*lasting.names]
        known = [False] * more.shape[1] + sure[:b] + [False] * b + sure[b:]
        lead = left.lead[:count, about]
        labels = [own[int(np.abs(column).argmax())] for column in lead.T]
        _, nonidentifiable = in_turn(
            (np.vstack([robot @ lead, again @ self.lift @ lead]), labels), (columns, names), known
        )
        whole = {part.name for n in asked if n.whole for part in n.parts(tree)}
        return tuple(each for each in nonidentifiable if each.name in whole)

    def _columns(self, rows: int) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
        """Of both halves along generic motions, passing numbers first; of the unknown payload."""
        rng = np.random.default_rng(SEEDS[0])
        theta = generic_robot(self.without.layout, rng)
        tree = self.without.tree
        ten = np.zeros((tree.n, 10))
        ten[tree.index(self.payload.joint)] = self.payload.values
        ten[tree.index(self.payload.joint), list(self.payload.unknown)] = rng.normal(
            size=len(self.payload.unknown)
        )
        found = []
        for half, bodies, seed in (
            (self.without, theta, SEEDS[0]),
            (self.loaded, theta + to_barycentric(tree, ten), SEEDS[1]),
        ):
            in_order = sorted(nuisances_of(half), key=lambda n: not n.passing)
            motion = np.random.default_rng(seed)
            found.append(generic_columns(half, in_order, rows, bodies, motion))
        return found[0], found[1], found[1][0] @ self.adds[:, list(self.payload.unknown)]


def pair_of(without: Problem, loaded: Problem, payload: KnownPayload) -> Pair:
    """Two recordings before any data.

    Args:
        without: The first recording, with what is known of robot and plate.
        loaded: The second, with the same settings.
        payload: What is known of the payload.
    """
    tree = without.tree
    numbers = {part.name for n in NUISANCES if not n.passing for part in n.parts(tree)}
    of_plate = {
        name: (value, DOUBT if sigma else 0.0)  # a doubt that both share counts once
        for name, (value, sigma) in without.settings.facts.items()
        if name in numbers
    }
    loaded = loaded.with_settings(zeros=False, known=of_plate)
    return Pair(
        without,
        loaded,
        payload,
        lift=np.asarray(loaded.minimal.matrix @ without.minimal.lift),
        adds=seen_of_payload(tree, loaded.minimal, payload.joint),
    )
