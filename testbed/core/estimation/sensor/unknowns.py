"""Unknowns of the instrument: their columns, and which of them no motion can identify."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import few
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import MASS, LinearConstraints, free
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.predicted_wrench import predict_wrench
from testbed.core.kernel.records import Signals
from testbed.core.robot.tree import Tree
from testbed.sensors.errors.plate_bias import PlateBias
from testbed.sensors.predicted_wrench import PredictedWrench, RowFilter
from testbed.sensors.systematic_error import Coefficient, SystematicError


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Coefficients of sensor errors, some of them unknown.

    Attributes:
        nuisances: The sensor errors.
        counts: Coefficients of each.
        coefficients: Of all, sensor error by sensor error.
        kept: Places of the unknown ones among them; the others are neutral.
    """

    nuisances: tuple[type[SystematicError], ...]
    counts: tuple[int, ...]
    coefficients: tuple[Coefficient, ...]
    kept: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown coefficients."""
        return tuple(self.coefficients[k].name for k in self.kept)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknown coefficients."""
        return tuple(self.coefficients[k].unit for k in self.kept)

    @property
    def neutral(self) -> Array:
        """Values of the unknown coefficients of sensors without errors."""
        return np.array([self.coefficients[k].neutral for k in self.kept])

    @property
    def terms(self) -> tuple[str, ...]:
        """Term of each unknown coefficient."""
        terms = np.repeat([n.term for n in self.nuisances], self.counts)
        return tuple(str(terms[k]) for k in self.kept)

    def unmixing(self, values: Array) -> Array | None:
        """Inverse of a mixture of the plate's channels, (6, 6); None for no mixture.

        Args:
            values: Of the unknown coefficients.
        """
        inverses = (error.unmixing(own) for error, own in self.by_error(values).items())
        return next((each for each in inverses if each is not None), None)

    def by_error(self, values: Array) -> dict[type[SystematicError], Array]:
        """Coefficients of each sensor error, those that are not unknown neutral.

        Args:
            values: Of the unknown coefficients.
        """
        every = np.array([each.neutral for each in self.coefficients])
        every[list(self.kept)] = values
        blocks = np.split(every, np.cumsum(self.counts, dtype=int))[:-1]
        return dict(zip(self.nuisances, blocks, strict=True))


def unknowns_of(tree: Tree, nuisances: Sequence[type[SystematicError]]) -> Unknowns:
    """All coefficients of sensor errors.

    Args:
        tree: The robot.
        nuisances: The sensor errors.
    """
    each = [error.coefficients(tree) for error in nuisances]
    coefficients = tuple(coefficient for own in each for coefficient in own)
    counts = tuple(len(own) for own in each)
    return Unknowns(
        tuple(nuisances), counts, coefficients, tuple(range(len(coefficients)))
    )


class Columns:
    """Columns of unknowns of the instrument, window by window."""

    def __init__(
        self,
        plan: Plan,
        filtered: RowFilter,
        values: Array,
        unknowns: Unknowns,
        unmixing: Array | None = None,
        unfolded: RowFilter | None = None,
    ) -> None:
        """To first order around an estimate.

        Args:
            plan: The rows.
            filtered: The filter that they pass.
            values: Minimal parameters, (p,).
            unknowns: Whose columns.
            unmixing: Inverse of the mixture of the plate's channels that was taken back, (6, 6).
            unfolded: At more instants, for nuisances that need them; default the same filter.
        """
        self._unfolded = unfolded or filtered
        self._unmixing = unmixing
        self._plan, self._filtered, self._unknowns = plan, filtered, unknowns
        layout = plan.layout
        self._theta = np.asarray(layout.theta @ (layout.basis @ values))
        self._kept: dict[int, Array] = {}
        # bytes of columns that are kept from one pass to the next
        self._keeps = plan.rows * 6 * len(unknowns.kept) * 8 < 64e6

    def __call__(self, signals: Signals, first: int) -> Array:
        """Of a window's rows, (6, rows, s).

        Args:
            signals: The window's.
            first: Number of its first row.
        """
        if first in self._kept:
            return self._kept[first]
        made = self._made(signals, first)
        if self._keeps:
            self._kept[first] = made
        return made

    def _made(self, signals: Signals, first: int) -> Array:
        nuisances = self._unknowns.nuisances
        found = {
            finer: predict_wrench(
                self._plan,
                self._unfolded if finer else self._filtered,
                self._theta,
                signals,
                first,
            )
            for finer in {n.unfolded for n in nuisances}
        }
        made = [self._effect(n, found[n.unfolded]) for n in nuisances]
        kept = np.concatenate(made, axis=2)[..., list(self._unknowns.kept)]
        return kept.transpose(1, 0, 2)

    def _effect(
        self, error: type[SystematicError], predicted: PredictedWrench
    ) -> Array:
        """Columns of a sensor error, mixtures of the channels taken back."""
        columns = error.measured_columns(predicted)
        if not error.added or self._unmixing is None:
            return columns
        return self._unmixing @ columns


RATE = 50.0
"""Instants a second of the generic motion: the widest stencil below needs no more."""

SINES = 5
"""Of a joint's generic motion."""


@dataclass(frozen=True)
class NonIdentifiable:
    """A number of the instrument that is taken as zero, since others show the same.

    Attributes:
        name: Its name.
        by: The parameters, and the instrument's numbers, that change with it.
    """

    name: str
    by: tuple[str, ...]


def identifiable_subset(
    problem: Problem,
    nuisances: Sequence[type[SystematicError]],
    stated: LinearConstraints | None = None,
) -> tuple[Unknowns, tuple[NonIdentifiable, ...]]:
    """Which numbers of nuisances can be estimated beside the parameters.

    Args:
        problem: Robot and recording.
        nuisances: The kinds, earlier ones preferred.
        stated: What is known of parameters and of all numbers of the nuisances.
    """
    names, wanted = problem.names, unknowns_of(problem.layout.tree, nuisances)
    if not nuisances:
        return wanted, ()
    count, rng = len(wanted.coefficients), np.random.default_rng(1996)
    own, theirs = _generic_columns(
        problem, nuisances, 40 + (len(names) + count) // 2, rng
    )
    labels, sure = list(names), [False] * count
    if stated is not None and len(stated):
        left = free(stated)
        sure = [not row.any() for row in left.lead[len(names) :]]
        about = left.lead[: len(names)].any(axis=0)
        own = own @ left.lead[: len(names), about]
        labels = [
            names[int(np.abs(column).argmax())]
            for column in left.lead[: len(names), about].T
        ]
    kept, nonidentifiable = _in_turn((own, labels), (theirs, wanted.names), sure)
    return replace(wanted, kept=kept), nonidentifiable


Named = tuple[Array, Sequence[str]]
"""Columns, (rows, k), and what they are called."""


def _in_turn(
    known: Named, others: Named, sure: Sequence[bool]
) -> tuple[tuple[int, ...], tuple[NonIdentifiable, ...]]:
    """Columns that are linearly independent of those before them, and the rest.

    Args:
        known: The first.
        others: Taken one after the other.
        sure: Which of them are known anyway.

    Returns:
        Places of those that are identifiable; the rest.
    """
    columns, labels = _unit(known[0]), list(known[1])
    basis, _ = np.linalg.qr(columns)
    kept: list[int] = []
    nonidentifiable = []
    for k, column in enumerate(_unit(others[0]).T):
        if sure[k]:
            kept.append(k)
            continue
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        length = float(np.linalg.norm(rest))
        # length, of one, that others leave of a column that they imitate
        if length > 1e-6:
            basis = np.column_stack([basis, rest / length])
            columns = np.column_stack([columns, column])
            labels.append(others[1][k])
            kept.append(k)
            continue
        share = np.abs(np.linalg.lstsq(columns, column, rcond=None)[0])
        # share of a combination, in units of its largest, that is worth a name
        by = [n for n, s in zip(labels, share, strict=True) if s > 1e-6 * share.max()]
        nonidentifiable.append(NonIdentifiable(others[1][k], tuple(by)))
    return tuple(kept), tuple(nonidentifiable)


def explain_nonidentifiable(
    open_ones: Sequence[NonIdentifiable],
    known: Collection[str],
    nuisances: Collection[str],
) -> str:
    """What no motion identifies, and which facts would, in a line.

    Args:
        open_ones: Numbers of the plate.
        known: Names of the facts.
        nuisances: Kinds that are estimated.
    """
    first, more = open_ones[0], len(open_ones) - 1
    # characters for what imitates a number that is open
    phrase = (
        f"{first.name} from {few(first.by, 40)}{f', nor {more} others' * (more > 0)}"
    )
    zero = " (the zero of Fz is unknown: the mass alone does not)" * (
        MASS in known and PlateBias.term in nuisances
    )
    return (
        f"no motion identifies {phrase}: state a known value. A total mass (mass=20) and a gain "
        f"(gain/Fz=1) fix the scale{zero}; so does a gain with a centre of mass (centre/x=0.1)"
    )


def _unit(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    return columns / np.where(length > 0, length, 1.0)


def _generic_columns(
    problem: Problem,
    nuisances: Sequence[type[SystematicError]],
    rows: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Columns of the parameters and of the nuisances along a generic motion, (6 rows, .).

    Args:
        problem: Robot and recording.
        nuisances: The kinds.
        rows: Instants.
        rng: Draws the robot and its motion.
    """
    layout = problem.layout
    lead = layout.theta @ layout.basis
    theta = np.asarray(lead @ rng.normal(size=lead.shape[2]))
    motion = _generic_motion(np.arange(rows + 4) / RATE, problem.tree.n, rng)
    # a row is one instant; its slope needs five
    slopes = np.array([1, -8, 0, 8, -1]) / 12 * RATE
    weights = np.array([0, 0, 1.0, 0, 0])
    found = PredictedWrench(
        tree=layout.tree,
        gravity=layout.gravity,
        theta=theta,
        motion=motion,
        tare=problem.tare,
        time=motion.t[2:-2] - motion.t.mean(),
        filter=RowFilter(1, weights, slopes, 1, weights, slopes),
        measured=np.zeros((rows, 6, 5)),
    )
    parameters = linear(layout.tree, motion, lead, layout.gravity)[1][2:-2]
    theirs = np.concatenate([nuisance.columns(found) for nuisance in nuisances], axis=2)
    return parameters.reshape(6 * rows, -1), theirs.reshape(6 * rows, -1)


def _generic_motion(time: Array, joints: int, rng: np.random.Generator) -> Motion:
    """Sums of sines of random frequencies and amplitudes."""
    speed = 2 * np.pi * rng.uniform(0.1, 1.0, (SINES, joints))
    size = rng.normal(size=(2, SINES, joints)) / SINES
    phase = time[:, None, None] * speed
    wave = size[0] * np.sin(phase) + size[1] * np.cos(phase)
    rate = speed * (size[0] * np.cos(phase) - size[1] * np.sin(phase))
    return Motion(
        time, *(each.sum(axis=1) for each in (wave, rate, -(speed**2) * wave))
    )
