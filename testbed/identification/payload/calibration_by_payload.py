"""Calibrate the plate by a known payload: two recordings of one robot, without it and with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import block_diag, null_space

from testbed.arrays import Array, freeze
from testbed.blas import eigh
from testbed.diagnostics import Diagnostic, diagnose, ordered
from testbed.errors import SettingsError, UnknownName
from testbed.identification.calibration import Calibration, calibration_of, settings_of
from testbed.identification.diagnostics.diagnosis import quality
from testbed.identification.estimate import Estimate
from testbed.identification.identify import estimate_of
from testbed.identification.payload.payload import seen_of_payload
from testbed.identification.problem import Problem
from testbed.identification.regression.constraints import PAYLOAD, facts, free
from testbed.identification.regression.passes import Progress
from testbed.identification.sensor.correction import NUISANCES
from testbed.identification.sensor.estimates import Nuisance
from testbed.identification.sensor.plate import BIAS, TARE
from testbed.identification.sensor.unknowns import (
    NonIdentifiable,
    enough,
    explain_nonidentifiable,
    generic_columns,
    generic_robot,
    identifiable_subset,
    in_turn,
    unknowns_of,
)
from testbed.identification.settings import DEFAULTS, Settings, with_sigmas
from testbed.parameters.symbols import to_barycentric
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
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
        freeze(self, values=(10,), root=(10, 4))


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
    """Numbers of the plate that are the same in other recordings, and not identifiable from one.

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
        """Numbers of the plate that both recordings together do not identify: a generic robot's."""
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


ROUNDS = 4
"""Of estimates around what was found."""

SETTLED = 1e-3
"""Change of a number that is held: its square is below all sigmas."""

WIDER, LEAST = 100.0, 1e-5
"""Doubt about a number that was found and is held again, in its sigmas, and at least: it weighs
nothing, and what is left is no small difference of large numbers."""

LOADED = "with the payload"
"""Name of the second recording."""

IMPOSSIBLE = 1e-6
"""Chance below which the two recordings do not differ by the payload."""

SMALLEST = 1e-12
"""Eigenvalues below this share of the largest are rounding: facts that both estimates have."""


def calibrate_by_payload(
    tree: Tree,
    without: Recording | Source | str | Path,
    loaded: Recording | Source | str | Path,
    known: Mapping[str, float | Sequence[float]],
    joint: str | None = None,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings = DEFAULTS,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Calibration:
    """Numbers of the plate and parameters of the robot at once, from two recordings.

    Args:
        tree: The robot without the payload; its inertias are not used, except for
            `settings.zeros`, which the link with the payload does not have.
        without: The recording without it, as for `identify`.
        loaded: The one with it, along any other motion.
        known: A value, or value and sigma, by name: "payload/mass" [kg], coordinates of its
            centre "payload/x", y, z [m]; and what `calibrate` takes, of the first recording.
        joint: The payload is on the link that this one moves; default the last.
        gravity: (3,) [m/s^2], bedplate frame; default as for `identify`.
        settings: As for `calibrate`.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: A recording cannot be used.
        SettingsError: What is known does not suffice; says what is left open.
    """
    facts = with_sigmas(known)
    payload = known_payload(
        tree, joint, {name: both for name, both in facts.items() if name.startswith(PAYLOAD)}
    )
    own = {name: both for name, both in facts.items() if not name.startswith(PAYLOAD)}
    settings = settings_of(settings, own)
    first, second = (
        Problem.of(
            tree,
            each,
            "external",
            settings,
            gravity=gravity,
            threads=threads,
            progress=progress,
        )
        for each in (without, loaded)
    )
    if (first.tree.gravity != second.tree.gravity).any():
        raise SettingsError("the two recordings are under different gravity")
    pair = pair_of(first, second, payload)
    if pair.open:
        raise SettingsError(explain_nonidentifiable(pair.open, settings.known, settings.nuisances))

    def estimate(half: Problem, held: Mapping[str, tuple[float, float]]) -> Estimate:
        known = half.settings.facts | {name: held[name] for name in open_alone(half)}
        return estimate_of(half.with_settings(known=known))

    held = _at_first(pair)
    for _ in range(ROUNDS):
        alone = estimate(pair.without, held)
        found = joined(pair, alone, estimate(pair.loaded, held))
        now = {n.name: (n.value, _doubt(n.sigma)) for n in found.nuisances if n.name in held}
        calm = all(abs(now[name][0] - held[name][0]) < SETTLED for name in held)
        if calm and all(held[name][1] < DOUBT for name in held):
            break
        held = now
    return calibration_of(tree, settings.facts | facts, found)


def _doubt(sigma: float) -> float:
    """Of a number that is held and was found: far more than is left, little for rounding."""
    return min(max(WIDER * sigma, LEAST), DOUBT)


def _at_first(pair: Pair) -> dict[str, tuple[float, float]]:
    """What is held, as it should be where nothing is wrong, with a large doubt."""
    names = {*open_alone(pair.without), *open_alone(pair.loaded)}
    return {
        part.name: (part.right, DOUBT)
        for nuisance in nuisances_of(pair.without)
        for part in nuisance.parts(pair.without.tree)
        if part.name in names
    }


def joined(pair: Pair, first: Estimate, second: Estimate) -> Estimate:
    """The first estimate, given that the plate is the second's, and the robot but for the payload.

    Args:
        pair: What is known.
        first: Of the recording without payload.
        second: Of the one with it.
    """
    facts = _facts(pair, first, second)
    spread = _covariance(first)
    across = spread @ facts.of_first.T
    others = facts.of_second @ _covariance(second) @ facts.of_second.T + facts.doubt
    inverse, rank = _inverse(facts.of_first @ across + others)
    gain = across @ inverse
    left = np.eye(len(spread)) - gain @ facts.of_first
    moved, spread = -gain @ facts.gap, left @ spread @ left.T + gain @ others @ gain.T
    chance = float(special.chdtrc(max(rank, 1), facts.gap @ inverse @ facts.gap))
    p = len(first.values)
    numbers = zip(first.nuisances, moved[p:], np.diagonal(spread)[p:], strict=True)
    joint = replace(
        first,
        values=first.values + moved[:p],
        sigma=np.sqrt(np.maximum(np.diagonal(spread)[:p], 0.0)),
        covariance=spread[:p, :p],
        nuisances=tuple(
            replace(each, value=each.value + float(by), sigma=float(np.sqrt(max(variance, 0.0))))
            for each, by, variance in numbers
        ),
        nuisance_covariance=spread[p:, p:],
        nuisance_cross=spread[:p, p:],
    )
    return replace(joint, diagnostics=_diagnostics(pair, first, second, joint, chance))


class _Facts(NamedTuple):
    """Facts about two estimates x, y: of_first x + of_second y + known = 0.

    Attributes:
        of_first: (k, p + s).
        of_second: (k, p' + s').
        gap: What is there in place of zero, (k,).
        doubt: Covariance of what is known, (k, k).
    """

    of_first: Array
    of_second: Array
    gap: Array
    doubt: Array


def _facts(pair: Pair, first: Estimate, second: Estimate) -> _Facts:
    """The payload, in the directions in which nothing else may differ; then the plate."""
    names = [[each.name for each in estimate.nuisances] for estimate in (first, second)]
    passing = {n.kind for n in NUISANCES if n.passing}
    shared = [n.name for n in first.nuisances if n.kind not in passing and n.name in names[1]]
    size = np.sqrt(np.diagonal(second.covariance))
    shared_rows = null_space((pair.free / size[:, None]).T).T / size
    ours = block_diag(
        shared_rows @ pair.lift, np.eye(len(names[0]))[[names[0].index(n) for n in shared]]
    )
    theirs = block_diag(-shared_rows, -np.eye(len(names[1]))[[names[1].index(n) for n in shared]])
    known = np.append(shared_rows @ pair.adds @ pair.payload.values, np.zeros(len(shared)))
    root = np.vstack([shared_rows @ pair.adds @ pair.payload.root, np.zeros((len(shared), 4))])
    return _Facts(
        of_first=ours,
        of_second=theirs,
        gap=ours @ _values(first) + theirs @ _values(second) + known,
        doubt=root @ root.T,
    )


def _values(estimate: Estimate) -> Array:
    return np.append(estimate.values, [each.value for each in estimate.nuisances])


def _covariance(estimate: Estimate) -> Array:
    """Of parameters and numbers of the instrument, (p + s, p + s)."""
    across = estimate.nuisance_cross
    return np.block([[estimate.covariance, across], [across.T, estimate.nuisance_covariance]])


def _inverse(matrix: Array) -> tuple[Array, int]:
    """Of a covariance in which some facts have none, and its rank."""
    size = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    scale = np.where(size > 0, size, 1.0)
    spread, axes = eigh(matrix / np.outer(scale, scale))
    kept = spread > SMALLEST * spread[-1]
    root = axes[:, kept] / np.sqrt(spread[kept]) / scale[:, None]
    return root @ root.T, int(kept.sum())


def _diagnostics(
    pair: Pair, first: Estimate, second: Estimate, joint: Estimate, chance: float
) -> tuple[Diagnostic, ...]:
    """Of each recording, what it leaves open apart, and of both together."""
    alone = {*quality(first), *quality(second)}
    before = [each for each in first.diagnostics if each not in alone]
    after = [
        replace(each, recording=LOADED)
        for each in second.diagnostics
        if each not in alone and each not in before
    ]
    mismatch = diagnose("payload.mismatch", pair.payload.joint, chance)
    return ordered([*before, *quality(joint), *after, *[mismatch] * (chance < IMPOSSIBLE)])
