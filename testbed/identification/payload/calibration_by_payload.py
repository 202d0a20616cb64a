"""Calibrate the plate by a known payload: two recordings of one robot, without it and with it.

Each recording is estimated by itself. What of the plate it does not tell alone, a scale above all,
is held near what it was found to be, with a large doubt. Two facts join the estimates afterwards:
the plate is the same, and the robot's parameters differ by the payload. The rule for Gaussians
puts them in; it is linear, so all is done again around what was found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.linalg import block_diag, null_space

from testbed.arrays import Array
from testbed.blas import eigh
from testbed.diagnostics.diagnostic import Diagnostic, diagnose, ordered
from testbed.errors import SettingsError
from testbed.identification.calibration import Calibration, calibration_of, settings_of
from testbed.identification.diagnostics.diagnosis import quality
from testbed.identification.estimate import Estimate
from testbed.identification.identify import estimate_of
from testbed.identification.payload.known_payload import (
    DOUBT,
    Pair,
    known_payload,
    nuisances_of,
    open_alone,
    pair_of,
)
from testbed.identification.problem import Problem
from testbed.identification.regression.constraints import PAYLOAD
from testbed.identification.regression.passes import Progress
from testbed.identification.sensor.catalogue import NUISANCES
from testbed.identification.sensor.identifiability import explain_nonidentifiable
from testbed.identification.settings import DEFAULTS, Settings
from testbed.identification.stated_values import with_sigmas
from testbed.recordings.recording import Recording
from testbed.recordings.source import Source
from testbed.robot.tree import Tree

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
