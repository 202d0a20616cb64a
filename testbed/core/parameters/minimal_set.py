"""Minimal set: combinations of barycentric parameters that a measurement identifies.

Source    [FRS96] eqs. (9)-(12); base rule and known zeros in docs/minimal-sets.md
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from testbed.core.base.arrays import Array, readonly_array
from testbed.core.base.codec import schema_by_name
from testbed.core.base.errors import UnknownName
from testbed.core.base.summary_table import SummaryTable, Value
from testbed.core.parameters.elimination import (
    BEDPLATE,
    CandidateParameter,
    Elimination,
    barycentric_rows,
    candidate_parameters,
    find_independent,
    shared_parameters_first,
)
from testbed.core.parameters.regroup import (
    FormulaWriter,
    LengthNotation,
    RegroupedBody,
    regroup_bodies,
)
from testbed.core.parameters.rules import SIGNALS, Signal, Triad, triad_about
from testbed.core.parameters.symbols import (
    Formula,
    Label,
    barycentric,
    forms_on_standard,
    parameter_names,
)
from testbed.core.robot.free_base import N_BASE_COORDINATES
from testbed.core.robot.tree import Tree, require_tree


@dataclass(frozen=True, eq=False, repr=False)
class MinimalSet(Value):
    """Minimal parameters delta = S theta of a robot for a measured signal.

    Attributes:
        model: "torque" (joint torques, delta_d) or "wrench" (bedplate wrench, delta_r).
        gravity: Assumed gravity, (3,) [m/s^2], bedplate frame.
        tared: True if only changes of the bedplate's static wrench are measured.
        known_zero: True for barycentric parameters assumed to be zero, (n, 10).
    """

    model: Signal
    gravity: Array
    tared: bool
    known_zero: NDArray[np.bool_]
    _tree: Tree
    _bodies: tuple[RegroupedBody, ...]
    _candidates: tuple[CandidateParameter, ...]
    _elimination: Elimination

    __get_pydantic_core_schema__ = schema_by_name(lambda minimal: minimal.model)

    def __repr__(self) -> str:
        return f"<MinimalSet of the {self.model} model, {self.count}: {', '.join(self.names)}>"

    def __str__(self) -> str:
        """Table of all parameters with formulas, as text."""
        return self.summary.text()

    @property
    def summary(self) -> SummaryTable:
        """Table of name, unit and formula of each parameter."""
        rows = zip(
            self.names,
            self.units,
            (each.right_text for each in self.formulas),
            strict=True,
        )
        head = f"{self.count} minimal parameters of the {self.model} model of {self.robot.name}"
        return SummaryTable(head, tuple(rows))

    @property
    def robot(self) -> Tree:
        """Robot that the parameters belong to."""
        return self._tree

    @property
    def of_sensor(self) -> bool:
        """True if a force sensor in the robot, not the bedplate, measures the wrench."""
        return self.model == "wrench" and self._tree.sensor is not None

    @property
    def lead(self) -> int:
        """Number of joints that move the force sensor's base body; 0 for the bedplate."""
        return self._tree.lead

    @property
    def subtracted_sensors(self) -> int:
        """Number of further force sensors whose wrenches are subtracted from the wrench."""
        return len(self._tree.cuts)

    @cached_property
    def _entries(self) -> tuple[CandidateParameter, ...]:
        """Independent candidate parameters, in the order of the minimal parameters."""
        return tuple(self._candidates[k] for k in self._elimination.independent_indices)

    @property
    def count(self) -> int:
        """Number N of minimal parameters."""
        return len(self._entries)

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """Symbolic names of the parameters: sums or multiples of symbols."""
        return tuple(entry.label for entry in self._entries)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters: mb*2z, K3yy, 2*K3d, ...; stars mark redefined parameters."""
        return tuple(label.text for label in self.labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter: kg, kg m or kg m^2."""
        return tuple(entry.unit for entry in self._entries)

    @property
    def bodies(self) -> tuple[int, ...]:
        """Index of the body of each parameter; -1 for the bedplate."""
        return tuple(entry.body for entry in self._entries)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Table and row of the rule that keeps each parameter, a key of `rules.RULE_REASONS`."""
        return tuple(
            "base" if b < 0 else self._bodies[b].row.number for b in self.bodies
        )

    @cached_property
    def unidentifiable(self) -> tuple[str, ...]:
        """Names of barycentric parameters in no minimal parameter, known zeros excluded."""
        is_absent = ~self.matrix.any(axis=0) & ~self.known_zero.ravel()
        return tuple(np.array(parameter_names(self._tree))[is_absent].tolist())

    @property
    def axial(self) -> tuple[int, ...]:
        """Joint index of each parameter that is an axial inertia (K_ee or mbar); -1 for others."""
        return tuple(entry.axial_joint for entry in self._entries)

    @property
    def dependent(self) -> tuple[tuple[int, dict[int, float]], ...]:
        """Candidate parameters that depend on the minimal parameters because of known zeros.

        Each pair contains the joint index of the candidate if it is an axial inertia (K_ee or
        mbar), otherwise -1, and its coefficients on the minimal parameters, keyed by index.
        """
        positions = {
            candidate: k
            for k, candidate in enumerate(self._elimination.independent_indices)
        }
        return tuple(
            (
                self._candidates[c].axial_joint,
                {positions[k]: share for k, share in shares.items()},
            )
            for c, shares in self._elimination.dependencies.items()
        )

    @cached_property
    def matrix(self) -> Array:
        """Matrix S of the minimal parameters on the barycentric parameters, (N, 10 n).

        Columns are ordered body by body as mbar mbx mby mbz Kxx Kxy Kxz Kyy Kyz Kzz. Columns of
        parameters known to be zero are zero.
        """
        rows = barycentric_rows(self._tree, self._bodies, self._entries)
        rows[:, self.known_zero.ravel()] = 0.0
        return readonly_array(rows, rows.shape, "matrix")

    @cached_property
    def lift(self) -> Array:
        """Right inverse of S, (10 n, N): sparse barycentric parameters for given delta.

        S lift = 1, known zeros remain zero, and replacing theta by lift S theta does not change the
        predictions of the model.
        """
        lift = self._elimination.right_inverse
        return readonly_array(self.with_carried_mass(lift), lift.shape, "lift")

    def with_carried_mass(self, theta: Array) -> Array:
        """Copy of theta with consistent mbar for the coordinate bodies of a free base.

        These bodies are massless, so their mbar equals that of the base. Without a free base, or
        with a force sensor on it, the copy is unchanged.

        Args:
            theta: Barycentric parameters, (10 n, ...), with any masses of the coordinate bodies.
        """
        parameters = np.array(theta)
        if self._tree.floating and self._tree.sensor is None:
            parameters[: 10 * (N_BASE_COORDINATES - 1) : 10] = parameters[
                10 * (N_BASE_COORDINATES - 1)
            ]
        return parameters

    @cached_property
    def standard_matrix(self) -> Array:
        """Matrix K of delta on the standard parameters in the order of `standard`, (N, 10 n).

        The parameters of each body are m mx my mz Ixx Ixy Iyy Ixz Iyz Izz, about the origin and
        along the axes of its frame.
        """
        rows = forms_on_standard(self._tree, self.matrix)
        return readonly_array(rows, self.matrix.shape, "standard_matrix")

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """Formulas of the parameters, in parameters of the body and of its children."""
        return self.formulas_with("symbols")

    @cached_property
    def auxiliary(self) -> tuple[Formula, ...]:
        """Formulas of the starred (redefined) parameters in `formulas`, end bodies first."""
        return self.auxiliary_with("symbols")

    def formulas_with(self, lengths: LengthNotation) -> tuple[Formula, ...]:
        """Formulas of the parameters, with lengths as symbols or as numbers.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = FormulaWriter(self._tree, self._bodies, self.known_zero, lengths)
        return tuple(namer.formula(e.label, e.body, e.form) for e in self._entries)

    def auxiliary_with(self, lengths: LengthNotation) -> tuple[Formula, ...]:
        """Formulas of the starred (redefined) parameters, with symbolic or numeric lengths.

        The formulas are limited to parameters on the right-hand sides of `formulas_with` or of
        these formulas. End bodies come first.

        Args:
            lengths: "symbols" prints l12z, "numbers" its value.
        """
        namer = FormulaWriter(self._tree, self._bodies, self.known_zero, lengths)
        referenced = {
            t.symbol for formula in self.formulas_with(lengths) for t in formula.right
        }
        formulas: list[Formula] = []
        for body in range(self._tree.n):
            for component in range(1, 10):
                symbol = namer.component(body, component)
                if (
                    symbol.is_redefined and symbol in referenced
                ):  # what migrates is never kept
                    formulas.insert(0, namer.redefinition(body, component))
                    referenced |= {term.symbol for term in formulas[0].right}
        return tuple(formulas)

    @property
    def triads(self) -> dict[int, Triad]:
        """Triads (u, v, w), in the body's frame, of bodies with parameters along inclined axes.

        Inclined axes are not axes of the body frame. The triads are keyed by body index, -1 for the
        bedplate; w is the joint axis, the only axis of rotation, or the direction of gravity.
        """
        triads = {
            b: self._bodies[b].row.triad for b in sorted(set(self.bodies)) if b >= 0
        }
        if BEDPLATE in self.bodies:
            triads[BEDPLATE] = triad_about(self.gravity / np.linalg.norm(self.gravity))
        return {body: triad for body, triad in triads.items() if triad.is_inclined}

    def values(self, theta: ArrayLike) -> Array:
        """Minimal parameters delta = S theta, (N,).

        Args:
            theta: Barycentric parameters, (n, 10).
        """
        return self.matrix @ np.ravel(np.asarray(theta, dtype=np.float64))


def minimal_set(
    tree: Tree,
    model: Signal | Signal,
    gravity: ArrayLike | None = None,
    zeros: bool | Sequence[str] = False,
    tared: bool = False,
) -> MinimalSet:
    """Minimal set of a robot by the recursive rules, [FRS96] Tables 2-5.

    Parameters are ordered body by body from the end bodies to the base, as in the paper. A wrench
    set starts with the parameters shared with the torque set.

    Args:
        tree: The robot; its inertias matter only for `zeros`.
        model: "torque" for joint torques, "wrench" for the bedplate's wrench.
        gravity: Gravity acceleration, (3,) [m/s^2], bedplate frame; default the model file's.
        zeros: Barycentric parameters known to be zero: True for all parameters that are zero in
            the model file, or a list of names such as "mb1x", "K2xy".
        tared: True if the bedplate's static wrench in one posture has been subtracted, so that
            only changes of the static wrench are measured.

    Raises:
        UnknownName: The signal or a name in `zeros` does not exist.
    """
    require_tree(tree, "minimal_set(robot, signal)")
    if model not in SIGNALS:
        raise UnknownName("signal", model, SIGNALS)
    g = tree.gravity_or(gravity)
    known_zero = known_zero_mask(tree, zeros)
    bodies = regroup_bodies(tree, model, g, tared=tared)
    entries = candidate_parameters(tree, bodies, model, g, tared)
    if model == "wrench" and not tree.lead:
        entries = shared_parameters_first(
            tree, entries, bodies, regroup_bodies(tree, "torque", g)
        )
    elimination = find_independent(tree, bodies, entries, known_zero)
    return MinimalSet(
        model, g, tared, known_zero, tree, bodies, tuple(entries), elimination
    )


def selection(torque_set: MinimalSet, wrench_set: MinimalSet) -> Array:
    """Matrix S with delta_d = S delta_r, (N_d, N_r); [FRS96] eq. (11).

    Each joint torque is a component of a wrench that is part of the bedplate's wrench. Therefore S
    exists for every tree. Its rows need not be unit vectors.

    Args:
        torque_set: Minimal set delta_d of the joint torques.
        wrench_set: Minimal set delta_r of the wrench, of the same robot, gravity and known zeros.

    Raises:
        ValueError: The sets do not belong together: delta_d is not in the span of delta_r.
    """
    s = torque_set.matrix @ wrench_set.lift
    s[np.abs(s) < 1e-13] = 0.0
    gap = np.abs(s @ wrench_set.matrix - torque_set.matrix).max(initial=0.0)
    if gap > 1e-9 * np.abs(torque_set.matrix).max(initial=1.0):
        raise ValueError(f"delta_d is not in the span of delta_r (off by {gap:.1e})")
    return readonly_array(s, (torque_set.count, wrench_set.count), "S")


def known_zero_mask(tree: Tree, zeros: bool | Sequence[str]) -> NDArray[np.bool_]:
    """Mask of barycentric parameters known to be zero, (n, 10).

    Parameters of massless bodies are always known to be zero.

    Args:
        tree: The robot.
        zeros: True for all parameters that are zero in the model file, or a list of names.

    Raises:
        UnknownName: A name is not that of a barycentric parameter.
    """
    is_zero = np.zeros((tree.n, 10), dtype=bool)
    is_zero[list(tree.bare)] = True
    if isinstance(zeros, bool):
        return is_zero | _model_file_zeros(tree) if zeros else is_zero
    flags = is_zero.ravel()
    names = parameter_names(tree)
    for name in [zeros] if isinstance(zeros, str) else zeros:
        if name not in names:
            raise UnknownName("barycentric parameter", name, names)
        flags[names.index(name)] = True
    return flags.reshape(tree.n, 10)


def _model_file_zeros(tree: Tree) -> NDArray[np.bool_]:
    """Mask of barycentric parameters that are zero in the model file, (n, 10).

    A parameter is treated as zero if its magnitude is at most 1e-12 times the body's largest
    parameter of the same unit. For first moments, sqrt(mass * largest component of the tensor) is
    used instead if it is larger.
    """
    theta = np.abs(barycentric(tree))
    mass, moments, tensors = theta[:, :1], theta[:, 1:4], theta[:, 4:]
    tensor = tensors.max(axis=1, keepdims=True)
    # moments may all be rounding: compare with a mass at a distance of the size of the body
    moment = np.maximum(moments.max(axis=1, keepdims=True), np.sqrt(mass * tensor))
    scale = np.repeat(np.hstack([mass, moment, tensor]), (1, 3, 6), axis=1)
    # a parameter this much smaller than its body's others of the same unit is zero in the file
    return theta <= 1e-12 * scale
