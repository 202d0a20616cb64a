"""Coefficients of sensor errors: regressor columns and identifiable subset."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import shortened_list
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import (
    TOTAL_MASS,
    LinearConstraints,
    free,
)
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.predicted_wrench import window_prediction
from testbed.core.kernel.records import SignalWindow
from testbed.core.robot.tree import Tree
from testbed.sensors.errors.plate_bias import PlateBias
from testbed.sensors.predicted_wrench import PredictedWrench, RowFilter
from testbed.sensors.systematic_error import Coefficient, SystematicError


@dataclass(frozen=True, eq=False)
class SensorUnknowns:
    """Coefficients of sensor errors, a subset of which is unknown.

    Attributes:
        nuisances: Sensor errors.
        counts: Number of coefficients of each sensor error.
        coefficients: All coefficients, grouped by sensor error.
        unknown_indices: Indices of the unknown coefficients; the others have neutral values.
    """

    nuisances: tuple[type[SystematicError], ...]
    counts: tuple[int, ...]
    coefficients: tuple[Coefficient, ...]
    unknown_indices: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown coefficients."""
        return tuple(self.coefficients[k].name for k in self.unknown_indices)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknown coefficients."""
        return tuple(self.coefficients[k].unit for k in self.unknown_indices)

    @property
    def neutral(self) -> Array:
        """Values of the unknown coefficients for sensors without errors."""
        return np.array([self.coefficients[k].neutral for k in self.unknown_indices])

    @property
    def terms(self) -> tuple[str, ...]:
        """Term of each unknown coefficient."""
        terms = np.repeat([n.term for n in self.nuisances], self.counts)
        return tuple(str(terms[k]) for k in self.unknown_indices)

    def unmixing(self, values: Array) -> Array | None:
        """Inverse of the crosstalk matrix of the plate's channels, (6, 6); None without crosstalk.

        Args:
            values: Values of the unknown coefficients, (s,).
        """
        inverses = (
            error.unmixing_matrix(coefficients)
            for error, coefficients in self.by_error(values).items()
        )
        return next((inverse for inverse in inverses if inverse is not None), None)

    def by_error(self, values: Array) -> dict[type[SystematicError], Array]:
        """Values of all coefficients, keyed by sensor error; neutral for known coefficients.

        Args:
            values: Values of the unknown coefficients, (s,).
        """
        coefficients = np.array(
            [coefficient.neutral for coefficient in self.coefficients]
        )
        coefficients[list(self.unknown_indices)] = values
        blocks = np.split(coefficients, np.cumsum(self.counts, dtype=int))[:-1]
        return dict(zip(self.nuisances, blocks, strict=True))


def sensor_unknowns(
    tree: Tree, nuisances: Sequence[type[SystematicError]]
) -> SensorUnknowns:
    """Coefficients of sensor errors on a robot, with every coefficient unknown.

    Args:
        tree: Robot.
        nuisances: Sensor errors.
    """
    coefficients_by_error = [error.coefficients(tree) for error in nuisances]
    coefficients = tuple(
        coefficient
        for error_coefficients in coefficients_by_error
        for coefficient in error_coefficients
    )
    counts = tuple(
        len(error_coefficients) for error_coefficients in coefficients_by_error
    )
    return SensorUnknowns(
        tuple(nuisances), counts, coefficients, tuple(range(len(coefficients)))
    )


class SensorErrorColumns:
    """Regressor columns of unknown sensor coefficients, window by window."""

    def __init__(
        self,
        plan: Plan,
        filtered: RowFilter,
        values: Array,
        unknowns: SensorUnknowns,
        unmixing: Array | None = None,
        unfolded: RowFilter | None = None,
    ) -> None:
        """Linearise the sensor errors about an estimate.

        Args:
            plan: Plan of the rows.
            filtered: Filter on rows.
            values: Minimal parameters, (p,).
            unknowns: Unknown coefficients.
            unmixing: Inverse of the crosstalk matrix used to correct the recording, (6, 6); None
                without such a correction.
            unfolded: Filter on rows at a higher rate, for sensor errors whose columns would alias
                encoder noise; default: `filtered`.
        """
        self._unfolded = unfolded or filtered
        self._unmixing = unmixing
        self._plan, self._filtered, self._unknowns = plan, filtered, unknowns
        layout = plan.layout
        self._theta = np.asarray(layout.theta @ (layout.basis @ values))
        self._cached_columns: dict[int, Array] = {}
        # columns are cached between passes if they take less than 64 MB
        self._is_small = plan.rows * 6 * len(unknowns.unknown_indices) * 8 < 64e6

    def __call__(self, signals: SignalWindow, first: int) -> Array:
        """Columns of a window's rows, (6, rows, s), cached if small.

        Args:
            signals: Signals of the window.
            first: Index of the window's first row.
        """
        if first in self._cached_columns:
            return self._cached_columns[first]
        columns = self._compute(signals, first)
        if self._is_small:
            self._cached_columns[first] = columns
        return columns

    def _compute(self, signals: SignalWindow, first: int) -> Array:
        """Compute the columns of a window's rows, (6, rows, s)."""
        nuisances = self._unknowns.nuisances
        predictions = {
            anti_aliased: window_prediction(
                self._plan,
                self._unfolded if anti_aliased else self._filtered,
                self._theta,
                signals,
                first,
            )
            for anti_aliased in {n.unfolded for n in nuisances}
        }
        blocks = [self._error_columns(n, predictions[n.unfolded]) for n in nuisances]
        columns = np.concatenate(blocks, axis=2)[
            ..., list(self._unknowns.unknown_indices)
        ]
        return columns.transpose(1, 0, 2)

    def _error_columns(
        self, error: type[SystematicError], predicted: PredictedWrench
    ) -> Array:
        """Columns of a sensor error after correction of the crosstalk, (rows, 6, k)."""
        columns = error.columns_from_measured(predicted)
        if not error.added or self._unmixing is None:
            return columns
        return self._unmixing @ columns


SAMPLING_RATE = 50.0
"""Sampling rate of the generic motion [Hz], sufficient for the widest stencil below."""

SINE_COUNT = 5
"""Number of sines in a joint's generic motion."""


@dataclass(frozen=True)
class NonIdentifiable:
    """Sensor coefficient that is collinear with others and kept at its neutral value.

    Attributes:
        name: Name of the coefficient.
        collinear_names: Names of the collinear parameters and coefficients.
    """

    name: str
    collinear_names: tuple[str, ...]


def identifiable_subset(
    problem: Problem,
    nuisances: Sequence[type[SystematicError]],
    constraints: LinearConstraints | None = None,
) -> tuple[SensorUnknowns, tuple[NonIdentifiable, ...]]:
    """Sensor coefficients that are identifiable together with the parameters, and the others.

    A rank test is applied to the columns of a robot with random parameters along a random motion;
    no data are used. Coefficients with known values are not tested; they are counted as
    identifiable.

    Args:
        problem: Robot and recording.
        nuisances: Sensor errors, of which the earlier ones have priority.
        constraints: Known values of parameters and coefficients.
    """
    names, unknowns = problem.names, sensor_unknowns(problem.layout.tree, nuisances)
    if not nuisances:
        return unknowns, ()
    count, rng = len(unknowns.coefficients), np.random.default_rng(1996)
    robot_columns, sensor_columns = _generic_columns(
        problem, nuisances, 40 + (len(names) + count) // 2, rng
    )
    labels, is_known = list(names), [False] * count
    if constraints is not None and len(constraints):
        null_space = free(constraints)
        is_known = [not row.any() for row in null_space.basis[len(names) :]]
        free_unknowns = null_space.basis[: len(names)].any(axis=0)
        robot_columns = robot_columns @ null_space.basis[: len(names), free_unknowns]
        labels = [
            names[int(np.abs(column).argmax())]
            for column in null_space.basis[: len(names), free_unknowns].T
        ]
    indices, nonidentifiable = _independent_columns(
        (robot_columns, labels), (sensor_columns, unknowns.names), is_known
    )
    return replace(unknowns, unknown_indices=indices), nonidentifiable


NamedColumns = tuple[Array, Sequence[str]]
"""Columns, (rows, k), and their names."""


def _independent_columns(
    first_columns: NamedColumns, candidates: NamedColumns, is_known: Sequence[bool]
) -> tuple[tuple[int, ...], tuple[NonIdentifiable, ...]]:
    """Indices of columns that are linearly independent of earlier columns, and the others.

    Unit columns are orthogonalised by Gram-Schmidt; a remainder of length up to 1e-6 is taken as
    zero.

    Args:
        first_columns: Columns that precede all candidates.
        candidates: Columns to be tested one by one.
        is_known: True for each candidate with a known value, which is not tested.

    Returns:
        Indices of the identifiable candidates, and the other candidates with their collinear
            columns.
    """
    columns, labels = _unit_columns(first_columns[0]), list(first_columns[1])
    basis, _ = np.linalg.qr(columns)
    indices: list[int] = []
    nonidentifiable = []
    for k, column in enumerate(_unit_columns(candidates[0]).T):
        if is_known[k]:
            indices.append(k)
            continue
        remainder = column - basis @ (basis.T @ column)
        remainder -= basis @ (basis.T @ remainder)
        length = float(np.linalg.norm(remainder))
        # smallest remainder of a unit column that is linearly independent
        if length > 1e-6:
            basis = np.column_stack([basis, remainder / length])
            columns = np.column_stack([columns, column])
            labels.append(candidates[1][k])
            indices.append(k)
            continue
        share = np.abs(np.linalg.lstsq(columns, column, rcond=None)[0])
        # smallest coefficient of a named column, relative to the largest
        by = [n for n, s in zip(labels, share, strict=True) if s > 1e-6 * share.max()]
        nonidentifiable.append(NonIdentifiable(candidates[1][k], tuple(by)))
    return tuple(indices), tuple(nonidentifiable)


def explain_nonidentifiable(
    unresolved: Sequence[NonIdentifiable],
    known: Collection[str],
    nuisances: Collection[str],
) -> str:
    """Error message about nonidentifiable coefficients, with known values that would help.

    Args:
        unresolved: Sensor coefficients that are not identifiable.
        known: Names of the known values.
        nuisances: Terms of the estimated sensor errors.
    """
    first, remaining_count = unresolved[0], len(unresolved) - 1
    # the collinear parameters may take 40 characters
    phrase = (
        f"{first.name} from {shortened_list(first.collinear_names, 40)}"
        f"{f', nor {remaining_count} others' * (remaining_count > 0)}"
    )
    bias_note = " (the zero of Fz is unknown: the mass alone does not)" * (
        TOTAL_MASS in known and PlateBias.term in nuisances
    )
    return (
        f"no motion identifies {phrase}: state a known value. A total mass (mass=20) and a gain "
        f"(gain/Fz=1) fix the scale{bias_note}; so does a gain with a centre of mass (centre/x=0.1)"
    )


def _unit_columns(columns: Array) -> Array:
    """Columns scaled to unit length; zero columns unchanged."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms > 0, norms, 1.0)


def _generic_columns(
    problem: Problem,
    nuisances: Sequence[type[SystematicError]],
    rows: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Columns of p parameters, (6 rows, p), and of s sensor coefficients, (6 rows, s).

    They are computed for random parameters along a random motion sampled at 50 Hz.

    Args:
        problem: Robot and recording.
        nuisances: Sensor errors.
        rows: Number of instants.
        rng: Random generator for parameters and motion.
    """
    layout = problem.layout
    basis = layout.theta @ layout.basis
    theta = np.asarray(basis @ rng.normal(size=basis.shape[2]))
    motion = _generic_motion(np.arange(rows + 4) / SAMPLING_RATE, problem.tree.n, rng)
    # each row is one instant; its derivative needs five
    slopes = np.array([1, -8, 0, 8, -1]) / 12 * SAMPLING_RATE
    weights = np.array([0, 0, 1.0, 0, 0])
    prediction = PredictedWrench(
        tree=layout.tree,
        gravity=layout.gravity,
        theta=theta,
        motion=motion,
        tare=problem.tare,
        time=motion.t[2:-2] - motion.t.mean(),
        filter=RowFilter(1, weights, slopes, 1, weights, slopes),
        measured_samples=np.zeros((rows, 6, 5)),
    )
    robot_columns = linear_inverse_dynamics(layout.tree, motion, basis, layout.gravity)[
        1
    ][2:-2]
    sensor_columns = np.concatenate(
        [nuisance.regressor_columns(prediction) for nuisance in nuisances], axis=2
    )
    return robot_columns.reshape(6 * rows, -1), sensor_columns.reshape(6 * rows, -1)


def _generic_motion(time: Array, joints: int, rng: np.random.Generator) -> Motion:
    """Joint motion as sums of sines with random frequencies and amplitudes.

    Args:
        time: Instants, (m,) [s].
        joints: Number of joints.
        rng: Random generator.
    """
    frequencies = 2 * np.pi * rng.uniform(0.1, 1.0, (SINE_COUNT, joints))
    amplitudes = rng.normal(size=(2, SINE_COUNT, joints)) / SINE_COUNT
    phases = time[:, None, None] * frequencies
    positions = amplitudes[0] * np.sin(phases) + amplitudes[1] * np.cos(phases)
    velocities = frequencies * (
        amplitudes[0] * np.cos(phases) - amplitudes[1] * np.sin(phases)
    )
    return Motion(
        time,
        *(
            each.sum(axis=1)
            for each in (positions, velocities, -(frequencies**2) * positions)
        ),
    )
