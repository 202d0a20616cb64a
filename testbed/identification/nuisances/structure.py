"""Which unknowns of the instrument no motion can tell from the robot, before any data.

The equations of a generic motion of a generic robot of the same geometry: what depends on
others there does so always.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.identification.known import Facts, free
from testbed.identification.nuisances.foretold import Foretold, RowFilter
from testbed.identification.nuisances.nuisance import Nuisance
from testbed.identification.nuisances.unknowns import Unknowns, unknowns_of
from testbed.kernel.layout import Layout

DEPENDENT = 1e-6
"""Length, of one, that others leave of a column that they imitate."""

NAMED = 1e-6
"""Share of a combination, in units of its largest, that is worth a name."""

SEED = 1996

RATE = 50.0
"""Instants a second of the generic motion: the widest stencil below needs no more."""

SINES = 5
"""Of a joint's generic motion."""


@dataclass(frozen=True)
class Imitated:
    """A number of the instrument that is taken as zero, since others show the same.

    Attributes:
        name: Its name.
        by: The parameters, and the instrument's numbers, that change with it.
    """

    name: str
    by: tuple[str, ...]


def told_apart(
    layout: Layout,
    names: Sequence[str],
    nuisances: Sequence[Nuisance],
    tare: Array,
    stated: Facts | None = None,
) -> tuple[Unknowns, tuple[Imitated, ...]]:
    """Which numbers of nuisances can be estimated beside the parameters.

    Args:
        layout: The robot's rows.
        names: Of the parameters.
        nuisances: The kinds, earlier ones preferred.
        tare: Static wrench of the pedestal, (6,) [N, N m].
        stated: What is known of parameters and of all numbers of the nuisances.
    """
    wanted = unknowns_of(layout.tree, nuisances)
    count = len(wanted.parts)
    own, theirs = _generic(layout, nuisances, tare, 40 + (len(names) + count) // 2)
    labels, sure = list(names), [False] * count
    if stated is not None and len(stated):
        left = free(stated)
        sure = [not row.any() for row in left.lead[len(names) :]]
        about = left.lead[: len(names)].any(axis=0)
        own = own @ left.lead[: len(names), about]
        labels = [
            names[int(np.abs(column).argmax())] for column in left.lead[: len(names), about].T
        ]
    known = _unit(own)
    basis, _ = np.linalg.qr(known)
    kept: list[int] = []
    imitated = []
    for k, column in enumerate(_unit(theirs).T):
        if sure[k]:
            kept.append(k)
            continue
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        length = float(np.linalg.norm(rest))
        if length > DEPENDENT:
            basis = np.column_stack([basis, rest / length])
            known = np.column_stack([known, column])
            labels.append(wanted.parts[k].name)
            kept.append(k)
            continue
        share = np.abs(np.linalg.lstsq(known, column, rcond=None)[0])
        by = [n for n, s in zip(labels, share, strict=True) if s > NAMED * share.max()]
        imitated.append(Imitated(wanted.parts[k].name, tuple(by)))
    return replace(wanted, kept=tuple(kept)), tuple(imitated)


def _unit(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(length > 0, length, 1.0))


def _generic(
    layout: Layout, nuisances: Sequence[Nuisance], tare: Array, rows: int
) -> tuple[Array, Array]:
    """Columns of the parameters and of the nuisances along a generic motion, (6 rows, .)."""
    rng = np.random.default_rng(SEED)
    n = layout.tree.n
    slopes = np.array([1, -8, 0, 8, -1]) / 12 * RATE  # a row is one instant; its slope needs five
    weights = np.array([0, 0, 1.0, 0, 0])
    filtered = RowFilter(1, weights, slopes, 1, weights, slopes)
    time = np.arange(rows + 4) / RATE
    speed = 2 * np.pi * rng.uniform(0.1, 1.0, (SINES, n))
    size = rng.normal(size=(2, SINES, n)) / SINES
    phase = time[:, None, None] * speed
    wave = size[0] * np.sin(phase) + size[1] * np.cos(phase)
    rate = speed * (size[0] * np.cos(phase) - size[1] * np.sin(phase))
    motion = Motion(time, *(s.sum(axis=1) for s in (wave, rate, -(speed**2) * wave)))
    lead = layout.theta @ layout.basis
    theta = lead @ rng.normal(size=lead.shape[2])
    middle = time[2:-2] - time.mean()
    none = np.zeros((rows, 6, 5))  # nothing was measured
    found = Foretold(layout.tree, layout.gravity, theta, motion, tare, middle, filtered, none)
    parameters = linear(layout.tree, motion, lead, layout.gravity)[1][2:-2]
    theirs = np.concatenate([nuisance.columns(found) for nuisance in nuisances], axis=2)
    return parameters.reshape(6 * rows, -1), theirs.reshape(6 * rows, -1)
