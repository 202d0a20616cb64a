"""Which terms a joint's torque has: chosen by data that the fit has not seen.

A recording is cut into parts. A law is added if it lessens what a fit of all other parts leaves of
each part, on average by more than the standard error of that gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.blas import one_blas_thread
from testbed.identification.drive_regression import Torques
from testbed.identification.noise.scaled import scaled_solve
from testbed.robot.friction import (
    ASYMMETRIC,
    COULOMB,
    OFFSET,
    QUADRATIC,
    ROTOR,
    SQUARE_ROOT,
    VISCOUS,
    JointLaw,
    stribeck,
)

ALWAYS = (COULOMB, VISCOUS)
"""What every joint has."""

SPEEDS = tuple(float(f"{speed:.2g}") for speed in np.geomspace(0.02, 1.0, 14))
"""At which friction may fade out [rad/s or m/s]."""

OFFERED = (OFFSET, ASYMMETRIC, QUADRATIC, SQUARE_ROOT, *(stribeck(speed) for speed in SPEEDS))
"""What may be added."""

PARTS = 8
"""Of a recording."""

RUN = 16
"""Rows whose products are kept as one."""

SURE = 2.0
"""Standard errors that a gain has to have."""


@dataclass(frozen=True)
class Step:
    """One step of a choice.

    Attributes:
        kind: The law that was added, or "" for what every joint has.
        residual: Rms of what is left of unseen parts, over that of the torque.
        gain: How many standard errors it is better than without the law; 0 for the first step.
    """

    kind: str
    residual: float
    gain: float


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


def offered(laws: Sequence[JointLaw]) -> tuple[JointLaw, ...]:
    """All laws that a choice needs columns of; a rotor where it is asked for.

    Args:
        laws: What is asked for.
    """
    rotor = tuple(law for law in laws if law == ROTOR)
    return (*ALWAYS, *rotor, *OFFERED)


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
    """Of one joint's products: laws are added as long as one gains enough."""
    laws = [law for law in place if law in (*ALWAYS, ROTOR)]
    open_laws = [law for law in OFFERED if law in place]
    left = _held_out(products, [place[law] for law in laws])
    steps = [Step("", _rms(left), 0.0)]
    while True:
        tried = {law: _held_out(products, [place[k] for k in (*laws, law)]) for law in open_laws}
        if not tried:
            return Choice(tuple(laws), tuple(steps), None)
        best = min(tried, key=lambda law: float(tried[law][:, 0].sum()))
        step = Step(best.kind, _rms(tried[best]), _gain(left, tried[best]))
        if step.gain < SURE:
            return Choice(tuple(laws), tuple(steps), step)
        laws.append(best)
        steps.append(step)
        left = tried[best]
        fades = best.kind.startswith("stribeck")
        open_laws = [
            law
            for law in open_laws
            if law != best and not (fades and law.kind.startswith("stribeck"))
        ]


def _held_out(products: Array, columns: list[int]) -> Array:
    """What fits of all other parts leave of each: squares and squares of the torque, (PARTS, 2)."""
    own, y = np.array([0, *columns]), products.shape[1] - 1
    whole = products.sum(axis=0)
    found = np.zeros((len(products), 2))
    for k, part in enumerate(products):
        others = whole - part
        values = scaled_solve(others[np.ix_(own, own)], others[own, y])
        ends = np.append(-values, 1.0)
        at = np.append(own, y)
        found[k] = max(float(ends @ part[np.ix_(at, at)] @ ends), 0.0), part[y, y]
    return found


def _rms(left: Array) -> float:
    """Of what is left, over that of the torque."""
    return float(np.sqrt(left[:, 0].sum() / max(left[:, 1].sum(), np.finfo(float).tiny)))


def _gain(before: Array, after: Array) -> float:
    """How many standard errors better, part by part."""
    gained = before[:, 0] - after[:, 0]
    error = float(gained.std(ddof=1) / np.sqrt(len(gained)))
    return float(gained.mean()) / max(error, np.finfo(float).tiny)
